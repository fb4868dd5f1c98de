"""HEIC, the format of phones: read by the package pillow-heif where it is installed."""

from __future__ import annotations

HEIF_SUFFIXES = (".heic", ".heif")
"""Endings of such files, in lower case."""


def read_heif() -> bool:
    """Let Pillow open HEIC files in this process from now on; False without pillow-heif."""
    try:
        import pillow_heif
    except ImportError:
        return False
    pillow_heif.register_heif_opener()
    return True
