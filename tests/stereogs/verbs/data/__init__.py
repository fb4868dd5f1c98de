"""Tests of `stereogs.verbs.data`, which import its modules."""
