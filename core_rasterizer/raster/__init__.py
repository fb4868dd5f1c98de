"""From Gaussians on a device to images, and from gradients of images back to gradients of Gaussians."""

from .block import Block, pack, unpack, unpack_all
from .coverage import Coverage
from .footprint import DILATION, Footprint
from .frame import Frame
from .images import Images, Outputs
from .renderer import Renderer
from .request import NEAR_PLANE, RenderRequest

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
