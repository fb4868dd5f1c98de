"""`stereo_depth`: depth from a photograph and a render of what a camera to its right would see (StereoGS)."""

from .regularizer import StereoDepth, stereogs_register_regularizers

__all__ = ["StereoDepth", "stereogs_register_regularizers"]
