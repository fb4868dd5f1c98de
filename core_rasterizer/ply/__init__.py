"""Gaussians and points in PLY files."""

from .files import holds_gaussians, load_ply, load_points, save_ply

__all__ = ["holds_gaussians", "load_ply", "load_points", "save_ply"]
