"""`dtu`: scans of the DTU MVS data set (Jensen et al. 2014) in the sparse-view protocol."""

from .loader import DTUScene, stereogs_register_scenes

__all__ = ["DTUScene", "stereogs_register_scenes"]
