"""Tests of `registry.testing`, which import its modules."""
