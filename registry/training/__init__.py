"""The training loop and checkpoints."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .checkpoint import CHECKPOINT, explain_misfit, load_checkpoint, read_checkpoint
    from .initial_model import new_model
    from .trainer import Iteration, Trainer, one_torch_thread
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "CHECKPOINT",
    "Iteration",
    "Trainer",
    "explain_misfit",
    "load_checkpoint",
    "new_model",
    "one_torch_thread",
    "read_checkpoint",
]
