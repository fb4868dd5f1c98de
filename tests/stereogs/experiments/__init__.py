"""Tests of `stereogs.experiments`, which import its modules."""
