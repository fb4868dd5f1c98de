"""Tests of `registry.system`, which import its modules."""
