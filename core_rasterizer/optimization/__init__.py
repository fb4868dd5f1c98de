"""Gaussians that live on a device while they are optimized: model, loss, Adam, topology."""

from .adam import Adam
from .model import GaussianModel
from .photometric import photometric_loss
from .topology import Carried, Edit, apply_edit

__all__ = ["Adam", "Carried", "Edit", "GaussianModel", "apply_edit", "photometric_loss"]
