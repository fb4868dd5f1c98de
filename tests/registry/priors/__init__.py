"""Tests of `registry.priors`, which import its modules."""
