"""`onnx_stereo`: disparity from a stereo network in an ONNX file."""

from .prior import OnnxStereo, stereogs_register_priors

__all__ = ["OnnxStereo", "stereogs_register_priors"]
