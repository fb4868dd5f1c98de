"""Tests of `registry.calls`, which import its modules."""
