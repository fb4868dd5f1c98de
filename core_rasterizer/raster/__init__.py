"""Rendering of Gaussians on a device, forward and backward."""

from .block import Block, pack, unpack, unpack_all
from .frame import Frame
from .images import CHANNELS, Coverage, Images, Kept, Outputs, refuse_undefined
from .renderer import Renderer
from .request import DILATION, NEAR_PLANE, Footprint, RenderRequest

__all__ = [
    "CHANNELS",
    "DILATION",
    "NEAR_PLANE",
    "Block",
    "Coverage",
    "Footprint",
    "Frame",
    "Images",
    "Kept",
    "Outputs",
    "RenderRequest",
    "Renderer",
    "pack",
    "refuse_undefined",
    "unpack",
    "unpack_all",
]
