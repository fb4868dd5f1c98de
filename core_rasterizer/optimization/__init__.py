"""Training on a device: model, loss, Adam, edits."""

from .adam import Adam
from .edit import Carried, Edit, Relocation
from .engine import Engine, Model
from .model import GaussianModel, GaussianReader, OpenCLEngine
from .photometric import photometric_loss
from .topology import apply_edit

__all__ = [
    "Adam",
    "Carried",
    "Edit",
    "Engine",
    "GaussianModel",
    "GaussianReader",
    "Model",
    "OpenCLEngine",
    "Relocation",
    "apply_edit",
    "photometric_loss",
]
