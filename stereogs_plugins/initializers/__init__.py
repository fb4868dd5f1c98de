"""Initializers: the points that Gaussians start from."""
