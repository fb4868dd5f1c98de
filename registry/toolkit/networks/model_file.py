"""Read model files, verify their hash, and check untrusted ONNX content before onnxruntime loads it.

A tensor may store its values in a second file at any path, which the hash of the model does not cover. And
onnxruntime crashes if an empty tensor decides a loop or a branch, because it reads the first element.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from ...errors import PluginError

MODELS_VARIABLE = "STEREOGS_MODELS"
"""Environment variable with the path of the folder of model files."""
LARGEST = 1 << 31
"""2 GiB, the limit of the ONNX format."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-fA-F]{64}$")]
"""Type of settings for a file's SHA-256: 64 hexadecimal digits."""

_BYTES, _NUMBER = "TYPE_BYTES", "TYPE_INT64"
Schema = Mapping[str, Mapping[str, tuple[int, str]]]
"""Fields of messages, by name: their number, and their message or protobuf type."""
_SCHEMA: Schema = {
    "Model": {"graph": (7, "Graph"), "training": (20, "Training"), "functions": (25, "Function")},
    "Training": {"initialization": (1, "Graph"), "algorithm": (2, "Graph")},
    "Graph": {"nodes": (1, "Node"), "initializers": (5, "Tensor"), "sparse": (15, "Sparse")},
    "Function": {"nodes": (7, "Node"), "attributes": (11, "Attribute")},
    "Node": {"inputs": (1, _BYTES), "operator": (4, _BYTES), "attributes": (5, "Attribute")},
    "Attribute": {
        **{"t": (5, "Tensor"), "g": (6, "Graph"), "sparse_tensor": (22, "Sparse")},
        **{"tensors": (10, "Tensor"), "graphs": (11, "Graph"), "sparse_tensors": (23, "Sparse")},
    },
    "Sparse": {"values": (1, "Tensor"), "indices": (2, "Tensor")},
    "Tensor": {
        **{"dims": (1, _NUMBER), "name": (8, _BYTES)},
        **{"external_data": (13, _BYTES), "data_location": (14, _NUMBER)},
    },
}
"""Part of onnx.proto (IR version 10): the fields that lead to tensors and nodes, by number and type."""
_DECIDED_BY = {b"Loop": 2, b"If": 1}
"""Number of leading inputs that decide an operator's control flow; each must hold one element."""


class ModelFile(NamedTuple):
    """Content of a model file and its SHA-256, 64 lower-case hexadecimal digits."""

    content: bytes
    sha256: str


def model_files(*files: Path) -> tuple[Path, ...] | None:
    """Return the paths of files in the folder STEREOGS_MODELS; None if it is not set or one is missing."""
    folder = os.environ.get(MODELS_VARIABLE)
    paths = tuple(Path(folder or "", file) for file in files)
    return paths if folder and all(path.is_file() for path in paths) else None


def read_model_file(path: Path, sha256: str | None) -> ModelFile:
    """Read a local file; a `sha256` of None accepts any content.

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
            fix="put the file there, or change its path in the pipeline's YAML; `stereogs models` lists "
            "the networks of the ready pipelines, and `stereogs models get NAME` obtains one",
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


def check_content(content: bytes, path: Path) -> None:
    """Refuse damaged models, models with external weights, and models that would crash onnxruntime."""
    from google.protobuf.message import DecodeError

    try:
        model = _model_type().FromString(content)
    except DecodeError as error:
        raise PluginError(
            "onnxruntime cannot load the ONNX model: the file is truncated or damaged",
            where=str(path),
            fix="export the model to ONNX again, or copy it again",
        ) from error
    messages = list(_messages(model))
    tensors = [message for message in messages if message.DESCRIPTOR.name == "Tensor"]
    if any(tensor.external_data or any(tensor.data_location) for tensor in tensors):
        raise PluginError(
            "the model stores weights in a second file, which no hash would cover",
            where=str(path),
            fix="write it as one file: onnx.save(onnx.load(path), new_path)",
        )
    empty = {name for tensor in tensors if 0 in tensor.dims for name in tensor.name[-1:]}
    for node in (message for message in messages if message.DESCRIPTOR.name == "Node"):
        count = max((_DECIDED_BY.get(name, 0) for name in node.operator), default=0)
        for name in empty.intersection(node.inputs[:count]) - {b""}:
            raise PluginError(
                f"a loop or a branch of the model is decided by {name.decode(errors='replace')!r}, "
                "which has no elements",
                where=str(path),
                fix="export the model to ONNX again; such a tensor must hold one number",
            )


def _messages(message: Any) -> Iterator[Any]:
    """Yield a message and all messages inside it."""
    waiting = [message]
    while waiting:
        message = waiting.pop()
        yield message
        for field, values in message.ListFields():
            if field.message_type:
                waiting += values


@cache
def _model_type() -> Any:
    return message_type(_SCHEMA, "Model")


def message_type(schema: Schema, root: str) -> Any:
    """Return the class of the message `root`, which reads protobuf files of a part of their fields.

    All fields are repeated, so nothing is overwritten or merged.
    """
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="part.proto", package="part")
    for name, fields in schema.items():
        message = file.message_type.add(name=name)
        for field_name, (number, kind) in fields.items():
            field = message.field.add(name=field_name, number=number, label="LABEL_REPEATED")
            if kind in schema:
                field.type_name = f".part.{kind}"
            else:
                field.type = descriptor_pb2.FieldDescriptorProto.Type.Value(kind)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"part.{root}"))
