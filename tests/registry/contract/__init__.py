"""Tests of `registry.contract`, which import its modules."""
