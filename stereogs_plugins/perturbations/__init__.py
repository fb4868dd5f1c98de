"""Perturbations: change parameters after the optimizer's step."""
