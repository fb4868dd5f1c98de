"""Tests of `stereogs_plugins.priors`, which import its modules."""
