"""Keys of entries: hashes over all that an answer depends on."""

from __future__ import annotations

import hashlib
import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType


def content_key(*parts: object) -> str:
    """A hash over tensors (type, shape and every bit), bytes, texts, numbers and None, in order.

    Returns:
        32 hexadecimal digits.
    """
    from torch import Tensor

    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            array = part.detach().cpu().contiguous().numpy()
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        elif isinstance(part, bytes):
            digest.update(f"{len(part)} bytes\0".encode())
            digest.update(part)
        else:
            digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()[:32]


def source_digest(*definitions: Callable[..., Any] | ModuleType) -> str:
    """A hash over the source files that hold classes, functions or modules.

    Part of a key, it makes a changed line of the code that computes an answer ask again.

    Raises:
        TypeError: one of them is not defined in a file.
    """
    files = [inspect.getfile(definition) for definition in definitions]
    return content_key(*(Path(file).read_bytes() for file in files))
