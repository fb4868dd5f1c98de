"""Exporters: file formats for the trained Gaussians."""
