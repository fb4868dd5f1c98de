"""`llff`: captures with `poses_bounds.npy` (Mildenhall et al. 2019), also Mip-NeRF 360 in this format."""

from .loader import LLFFScene, stereogs_register_scenes

__all__ = ["LLFFScene", "stereogs_register_scenes"]
