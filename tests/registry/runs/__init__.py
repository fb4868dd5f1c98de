"""Tests of `registry.runs`, which import its modules."""
