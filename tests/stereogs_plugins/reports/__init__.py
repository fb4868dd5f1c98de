"""Tests of `stereogs_plugins.reports`, which import its modules."""
