"""Densification policies: add, move and remove Gaussians."""
