"""`lpips` and `lpips_proper`: learned perceptual distance (Zhang et al. 2018, version 0.1)."""

from .metric import LPIPS, ProperLPIPS, stereogs_register_metrics

__all__ = ["LPIPS", "ProperLPIPS", "stereogs_register_metrics"]
