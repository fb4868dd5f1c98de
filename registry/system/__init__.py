"""Files, locks, memory, signals and threads."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .files import new_folder, replacing, write_text
    from .memory import available_bytes, peak_memory_mb
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "available_bytes",
    "new_folder",
    "peak_memory_mb",
    "replacing",
    "write_text",
]
