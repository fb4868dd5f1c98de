"""Tests of `stereogs_plugins.regularizers`, which import its modules."""
