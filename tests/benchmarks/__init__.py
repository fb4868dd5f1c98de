"""Tests of `benchmarks`, which import its modules."""
