"""Torchvision's weights become the ONNX file that LPIPS reads.

    python -m stereogs_plugins.metrics.lpips.convert vgg vgg16-397923af.pth vgg16.onnx

It prints what to write into a pipeline. Where the weights come from: docs/protocols.md.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

from core_rasterizer import ExplainedError
from registry.toolkit.networks import read_model_file

from .backbone import LAYERS, backbone
from .files import read_tensors


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert a file; returns the exit status, 2 for a mistake that was explained."""
    parser = argparse.ArgumentParser(
        prog="python -m stereogs_plugins.metrics.lpips.convert",
        description="Make the ONNX file that the metric lpips reads from torchvision's weights.",
    )
    parser.add_argument("network", choices=sorted(LAYERS), help="whose weights they are")
    parser.add_argument("weights", type=Path, help="the file, .pth, .safetensors or .npz")
    parser.add_argument("out", type=Path, help="the ONNX file to write")
    given = parser.parse_args(arguments)
    try:
        tensors = read_tensors(read_model_file(given.weights, None).content, given.weights)
        content = backbone(given.network, tensors, str(given.weights))
        given.out.write_bytes(content)
    except (ExplainedError, OSError) as error:
        print(f"lpips: {error}", file=sys.stderr)
        return 2
    digest = hashlib.sha256(content).hexdigest()
    print(f"- use: lpips\n  network: {given.network}\n  file: {given.out}\n  sha256: {digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
