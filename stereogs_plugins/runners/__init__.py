"""Runners: train the runs of an ablation or a bench."""
