"""Tests of `registry.training`, which import its modules."""
