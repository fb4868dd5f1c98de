"""Training on a device: model, loss, Adam, edits."""

from .adam import Adam
from .edit import Carried, Edit, Relocation
from .engine import Engine, Model, Optimizer
from .model import GaussianModel, GaussianReader, OpenCLEngine, engine_on
from .photometric import photometric_loss
from .topology import apply_edit, shared_among_copies

__all__ = [
    "Adam",
    "Carried",
    "Edit",
    "Engine",
    "GaussianModel",
    "GaussianReader",
    "Model",
    "OpenCLEngine",
    "Optimizer",
    "Relocation",
    "apply_edit",
    "engine_on",
    "photometric_loss",
    "shared_among_copies",
]
