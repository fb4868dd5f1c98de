"""Cameras from photographs: features, matches, mapping, refinement, checks."""
