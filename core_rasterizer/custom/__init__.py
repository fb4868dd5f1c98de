"""Kernels that callers write: loss terms over pixels."""

from .pixel_term import PixelTerm

__all__ = ["PixelTerm"]
