"""`stereo_depth`: depth by stereo matching of a photograph and a rendered right view (StereoGS)."""

from .regularizer import StereoDepth, stereogs_register_regularizers

__all__ = ["StereoDepth", "stereogs_register_regularizers"]
