"""Tests of `stereogs.verbs.models`, which import its modules."""
