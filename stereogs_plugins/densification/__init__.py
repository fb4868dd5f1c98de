"""Densification policies: where Gaussians are added and removed."""
