"""A random stream for each part of a run, so that toggling one never shifts another's numbers."""

from __future__ import annotations

import hashlib


def derived_seed(seed: int, name: str) -> int:
    """A seed for the part called `name`, in [0, 2^63), the same on every machine.

    Args:
        seed: the run's seed.
        name: unique within the run, for example "regularizers.stereo_depth".
    """
    digest = hashlib.sha256(f"{seed}:{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
