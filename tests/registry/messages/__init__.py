"""Tests of `registry.messages`, which import its modules."""
