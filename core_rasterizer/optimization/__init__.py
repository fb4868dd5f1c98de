"""Gaussians that live on a device while they are optimized: model, loss, Adam, topology."""

from .adam import Adam
from .edit import Carried, Edit, Relocation
from .model import GaussianModel
from .model_reader import ModelReader
from .photometric import photometric_loss
from .relocation import shared_among_copies
from .topology import apply_edit

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
