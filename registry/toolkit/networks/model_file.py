"""Files with a model's weights: read once, held to their hash."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ...errors import PluginError

LARGEST = 1 << 31
"""Bytes, 2 GiB; ONNX files end there."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-fA-F]{64}$")]
"""The type of a setting that holds a file's hash: 64 hexadecimal digits."""


@dataclass(frozen=True)
class ModelFile:
    """A file's content.

    Args:
        content: all of it.
        sha256: its hash, 64 lower-case hexadecimal digits.
    """

    content: bytes
    sha256: str


def read_model_file(path: Path, sha256: str | None) -> ModelFile:
    """Read a local file that must have a hash; None takes any.

    Raises:
        PluginError: it cannot be read, is no regular file or larger than 2 GiB, or has another hash.
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
            fix="restore the file, or set the hash to its own if this file is meant",
        )
    return ModelFile(content, found)


def _unreadable(path: Path) -> str:
    """Why a path is not read: a device has no end, and a pipe may never answer. Empty if it can be."""
    size = path.stat().st_size
    if not path.is_file():
        return "it is no regular file"
    return f"it has {size:,} bytes, more than {LARGEST:,}" if size > LARGEST else ""
