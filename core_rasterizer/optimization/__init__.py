"""Training on a device: model, loss, Adam, edits."""

from .adam import Adam
from .edit import Carried, Edit, Relocation
from .model import GaussianModel, ModelReader
from .photometric import photometric_loss
from .topology import apply_edit, shared_among_copies

__all__ = [
    "Adam",
    "Carried",
    "Edit",
    "GaussianModel",
    "ModelReader",
    "Relocation",
    "apply_edit",
    "photometric_loss",
    "shared_among_copies",
]
