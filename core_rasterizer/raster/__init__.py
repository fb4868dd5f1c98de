"""Rendering of Gaussians on a device, forward and backward."""

from .block import Block, pack, unpack, unpack_all
from .frame import Frame
from .images import Coverage, Images, Outputs
from .renderer import Renderer
from .request import DILATION, NEAR_PLANE, Footprint, RenderRequest

__all__ = [
    "DILATION",
    "NEAR_PLANE",
    "Block",
    "Coverage",
    "Footprint",
    "Frame",
    "Images",
    "Outputs",
    "RenderRequest",
    "Renderer",
    "pack",
    "unpack",
    "unpack_all",
]
