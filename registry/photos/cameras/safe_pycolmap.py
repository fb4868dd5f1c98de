"""pycolmap, loaded in the one order in which it does no harm."""

from __future__ import annotations

from typing import Any


def import_pycolmap(least_severity: int = 2) -> Any:
    """The module `pycolmap`, loaded after Pillow.

    Its wheel exports a zlib of its own. The system's zlib, which Pillow uses, breaks if it is first
    loaded in pycolmap's wake, and PNG files come out damaged (Pillow 13 and pycolmap 4.2).

    Args:
        least_severity: what pycolmap logs below this is left out, in this process from now on: 0 is
            information, 1 a warning, 2 an error, 3 what ends the process.
    """
    from PIL import Image  # noqa: F401  loads the system's zlib first

    import pycolmap  # isort: skip

    pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, least_severity)
    return pycolmap
