"""Tests of `stereogs_plugins.metrics`, which import its modules."""
