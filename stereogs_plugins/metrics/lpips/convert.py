"""Convert torchvision's weights to the ONNX file that LPIPS reads.

    python -m stereogs_plugins.metrics.lpips.convert vgg vgg16-397923af.pth vgg16.onnx

Prints the metric's settings for a pipeline. Origin of the weights: docs/protocols.md.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

from core_rasterizer import ExplainedError
from registry import read_model_file

from .backbone import LAYERS, backbone
from .files import read_tensors


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert a file; return the exit status, 2 after a reported error."""
    parser = argparse.ArgumentParser(
        prog="python -m stereogs_plugins.metrics.lpips.convert",
        description="Convert torchvision's weights to the ONNX file that the metric lpips reads.",
    )
    parser.add_argument("network", choices=sorted(LAYERS), help="the network of the weights")
    parser.add_argument("weights", type=Path, help="weights file: .pth, .safetensors or .npz")
    parser.add_argument("out", type=Path, help="ONNX file to write")
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
