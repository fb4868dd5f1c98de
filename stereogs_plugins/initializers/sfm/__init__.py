"""`sfm`: sparse points that the training photographs agree on (structure from motion, poses known)."""

from .initializer import SfmInitializer, stereogs_register_initializers

__all__ = ["SfmInitializer", "stereogs_register_initializers"]
