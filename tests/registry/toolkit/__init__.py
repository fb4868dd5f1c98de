"""Tests of `registry.toolkit`, which import its modules."""
