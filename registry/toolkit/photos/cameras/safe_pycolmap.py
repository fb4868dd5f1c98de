"""pycolmap, loaded in the one order in which it does no harm."""

from __future__ import annotations

import signal
import threading
from typing import Any


def import_pycolmap(least_severity: int = 2) -> Any:
    """The module `pycolmap`, loaded after Pillow.

    Its wheel exports a zlib of its own. The system's zlib, which Pillow uses, breaks if it is first
    loaded in pycolmap's wake, and PNG files come out damaged (Pillow 13 and pycolmap 4.2). Loading it also
    takes SIGTERM, to print its own stack before the process ends: in the main thread, which alone may do
    so, the handler that was there is put back, so that a run still stops with a checkpoint.

    Args:
        least_severity: what pycolmap logs below this is left out, in this process from now on: 0 is
            information, 1 a warning, 2 an error, 3 what ends the process.
    """
    from PIL import Image  # noqa: F401  loads the system's zlib first

    import pycolmap  # isort: skip

    handler = signal.getsignal(signal.SIGTERM)  # Python's, which pycolmap has gone round
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)
    pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, least_severity)
    return pycolmap
