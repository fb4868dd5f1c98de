"""Tests of `registry.pipeline`, which import its modules."""
