"""Tests of `stereogs.quality`, which import its modules."""
