"""Perturbations: what moves parameters after the optimizer's step."""
