"""Tests of `stereogs_plugins.confidence`, which import its modules."""
