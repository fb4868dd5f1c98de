"""Kernels that callers write: loss terms over pixels, and numbers of Gaussians."""

from .gaussian_kernel import GaussianKernel
from .pixel_term import PixelTerm

__all__ = ["GaussianKernel", "PixelTerm"]
