"""MC-CNN "fast" (Zbontar & LeCun, JMLR 2016) from the checkpoint of CNES/Pandora_MCCNN."""

from __future__ import annotations

import io

from .onnx_graph import OnnxGraph

_LAYERS, _RADIUS = 5, 5


def convert(content: bytes) -> tuple[bytes, ...]:
    """Return a graph from `gray` [N, 1, H, W], standardized, to unit vectors `feat` [N, 64, H, W]."""
    import torch

    checkpoint = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    weights, graph = checkpoint["model"], OnnxGraph("mc_cnn_fast")
    image = graph.input("gray", ("N", 1, "H", "W"))
    around = graph.constant([0, 0, _RADIUS, _RADIUS] * 2, int)
    value = graph("Pad", image, around, mode="edge")
    for layer in range(_LAYERS):
        # Between two convolutions, the checkpoint counts a ReLU.
        kernel, bias = (weights[f"conv_blocks.{2 * layer}.{k}"] for k in ("weight", "bias"))
        value = graph(
            "Conv",
            *(value, graph.constant(kernel.numpy()), graph.constant(bias.numpy())),
            kernel_shape=[3, 3],
        )
        if layer < _LAYERS - 1:
            value = graph("Relu", value)
    graph.output("feat", graph("LpNormalization", value, axis=1, p=2), ("N", 64, "H", "W"))
    return (graph.content(),)
