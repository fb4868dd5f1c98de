"""Tests of `stereogs.experiments.benchmarking`, which import its modules."""
