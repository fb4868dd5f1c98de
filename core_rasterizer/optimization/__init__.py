"""Training on a device: model, loss, Adam, edits."""

from .adam import Adam
from .edit import Carried, Edit, Relocation
from .engine import Engine, Model
from .gaussian_kernel import GaussianKernel
from .model import GaussianModel, GaussianReader, OpenCLEngine
from .photometric import photometric_loss
from .pixel_term import PixelTerm
from .topology import apply_edit

__all__ = [
    "Adam",
    "Carried",
    "Edit",
    "Engine",
    "GaussianKernel",
    "GaussianModel",
    "GaussianReader",
    "Model",
    "OpenCLEngine",
    "PixelTerm",
    "Relocation",
    "apply_edit",
    "photometric_loss",
]
