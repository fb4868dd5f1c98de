"""Read model files and verify their hash."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ...errors import PluginError

LARGEST = 1 << 31
"""2 GiB, the limit of the ONNX format."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-fA-F]{64}$")]
"""Type of settings for a file's SHA-256: 64 hexadecimal digits."""


@dataclass(frozen=True)
class ModelFile:
    """A model file in memory.

    Args:
        content: Content of the file.
        sha256: SHA-256, 64 lower-case hexadecimal digits.
    """

    content: bytes
    sha256: str


def read_model_file(path: Path, sha256: str | None) -> ModelFile:
    """Read a local file.

    Args:
        sha256: Required hash; None accepts any file.

    Raises:
        PluginError: The file cannot be read, is not a regular file, is larger than 2 GiB, or has
            another hash.
    """
    try:
        problem = _unreadable(path)
        content = b"" if problem else path.read_bytes()
    except OSError as error:
        problem = str(error.strerror or error)
    if problem:
        raise PluginError(
            f"the model file cannot be read: {problem}",
            where=str(path),
            fix="write the path of a local file into the pipeline's YAML, for example "
            "`model: /models/stereo.onnx`; models are never downloaded",
        )
    found = hashlib.sha256(content).hexdigest()
    if sha256 is not None and sha256.strip().lower() != found:
        raise PluginError(
            f"the model file has the SHA-256 {found}, expected {sha256}",
            where=str(path),
            fix="restore the file, or change the hash in the pipeline if this file is intended",
        )
    return ModelFile(content, found)


def _unreadable(path: Path) -> str:
    """Return why a path must not be read, or an empty text; reading a device or a pipe may never end."""
    size = path.stat().st_size
    if not path.is_file():
        return "it is not a regular file"
    return f"it has {size:,} bytes, more than {LARGEST:,}" if size > LARGEST else ""
