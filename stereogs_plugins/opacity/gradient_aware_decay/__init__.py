"""`gradient_aware_decay`: opacities decay, the less the more the loss depends on them (StereoGS)."""

from .policy import GradientAwareDecay, stereogs_register_opacity_policies

__all__ = ["GradientAwareDecay", "stereogs_register_opacity_policies"]
