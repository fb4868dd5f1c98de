"""Default files of LPIPS in the folder STEREOGS_MODELS, by name and hash.

The hashes define the score: without a custom file it is always computed with these networks.
`stereogs models` lists their source.
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


KNOWN: dict[NetworkName, tuple[Files, ...]] = {
    "vgg": (
        Files(
            Path("lpips", "vgg16.onnx"),
            "e785fc29618e64c97a307d13e53fd51e159aab01394f8f71bac202b3bf36f6e5",
            Path("lpips", "vgg16_heads.safetensors"),
            "ddfd8f3f3b9c362e2cbb02d76c2c26e9845200eaec7046682ba568ab75dd7838",
        ),
        Files(
            Path("lpips_backbones", "vgg16_lpips_features_w16.onnx"),
            "5d131baa7cd450966866da7a806c705634e50cf6f7f726fe75b2fbb05308f467",
            Path("lpips_lin_v0.1", "vgg.pth"),
            "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
        ),
    ),
    "alex": (
        Files(
            Path("lpips", "alexnet.onnx"),
            "f90b1515587eaa01cd56738acd874ff08da068b2669e3a6ed10549ce84dd7a36",
            Path("lpips", "alexnet_heads.safetensors"),
            "e62475ea6ad0ed1976b09beae720c28ab9e11cbb36d123f1a4491e50352baa4e",
        ),
        Files(
            Path("lpips_backbones", "alexnet_lpips_features.onnx"),
            "37c11ff9d44661a85836f3553e7318a726c6b8d990b79fe4f58b44efe215faaf",
            Path("lpips_lin_v0.1", "alex.pth"),
            "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
        ),
    ),
}
"""Paths relative to the folder: what `stereogs models get lpips` writes, then an earlier conversion of
the same weights, whose features have the same bits. The VGG weights are float16."""


def known_files(network: NetworkName) -> Files | None:
    """Return the paths of the first complete set of a network's default files, or None."""
    for known in KNOWN[network]:
        found = model_files(known.network, known.heads)
        if found:
            return known._replace(network=found[0], heads=found[1])
    return None
