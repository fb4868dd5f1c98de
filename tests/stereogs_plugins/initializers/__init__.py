"""Tests of `stereogs_plugins.initializers`, which import its modules."""
