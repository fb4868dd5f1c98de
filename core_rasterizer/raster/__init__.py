"""From Gaussians on a device to images, and from gradients of images back to gradients of Gaussians."""

from .block import Block, pack, unpack, unpack_all
from .coverage import Coverage
from .frame import Frame
from .renderer import Renderer
from .request import NEAR_PLANE, RenderRequest

__all__ = [
    "NEAR_PLANE",
    "Block",
    "Coverage",
    "Frame",
    "RenderRequest",
    "Renderer",
    "pack",
    "unpack",
    "unpack_all",
]
