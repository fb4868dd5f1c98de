"""Tests of `stereogs_plugins.scenes`, which import its modules."""
