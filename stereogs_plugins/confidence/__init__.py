"""Estimators of how likely each pixel of a render is right."""
