"""`consistency_dense`: a point for every pixel whose depth other training views confirm (StereoGS)."""

from .initializer import ConsistencyDense, stereogs_register_initializers

__all__ = ["ConsistencyDense", "stereogs_register_initializers"]
