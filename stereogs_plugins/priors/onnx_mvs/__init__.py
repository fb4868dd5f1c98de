"""`onnx_mvs`: depth of each view from a multi-view network in an ONNX file."""

from .prior import OnnxMvs, stereogs_register_priors

__all__ = ["OnnxMvs", "stereogs_register_priors"]
