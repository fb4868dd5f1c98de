"""Default files of LPIPS in the folder STEREOGS_MODELS, by name and hash.

The hashes define the score: without a custom file it is always computed with these networks.
Origin of the files: docs/prior_models.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

from registry.toolkit.networks import model_files

NetworkName = Literal["vgg", "alex"]


class Files(NamedTuple):
    """The feature network, and the weights of the channels of its five layers."""

    network: Path
    sha256: str
    heads: Path
    heads_sha256: str


KNOWN: dict[NetworkName, Files] = {
    "vgg": Files(
        Path("lpips_backbones", "vgg16_lpips_features_w16.onnx"),
        "5d131baa7cd450966866da7a806c705634e50cf6f7f726fe75b2fbb05308f467",
        Path("lpips_lin_v0.1", "vgg.pth"),
        "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
    ),
    "alex": Files(
        Path("lpips_backbones", "alexnet_lpips_features.onnx"),
        "37c11ff9d44661a85836f3553e7318a726c6b8d990b79fe4f58b44efe215faaf",
        Path("lpips_lin_v0.1", "alex.pth"),
        "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
    ),
}
"""Paths relative to the folder; the VGG weights are float16."""


def known_files(network: NetworkName) -> Files | None:
    """Return a network's default files, or None if one is missing."""
    known = KNOWN[network]
    found = model_files(known.network, known.heads)
    return known._replace(network=found[0], heads=found[1]) if found else None
