"""Tests of `stereogs.verbs`, which import its modules."""
