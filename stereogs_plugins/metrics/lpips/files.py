"""The files that LPIPS reads: a network as ONNX or TorchScript, and the weights of its five layers.

Nothing is downloaded, and nothing is unpickled beyond plain tensors.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from registry import PluginError
from registry.toolkit.networks import OnnxModel, first_line, read_model_file

if TYPE_CHECKING:
    from pathlib import Path

Network = Callable[..., list[Tensor]]
"""Takes images `[1, 3, H, W]` float32, as many as the file has inputs; returns all its outputs."""

CHANNELS = {"vgg": (64, 128, 256, 512, 512), "alex": (64, 192, 384, 256, 256)}
"""Of the five layers that LPIPS compares, by the name of the network."""


def read_network(path: Path, sha256: str) -> Network:
    """An `.onnx` file through onnxruntime, any other as TorchScript.

    Raises:
        PluginError: it cannot be read, has another hash, or is no such file.
    """
    if path.suffix.lower() == ".onnx":
        return _onnx_network(OnnxModel(path, sha256, "cpu"))
    content = read_model_file(path, sha256).content
    try:
        module = torch.jit.load(io.BytesIO(content), map_location="cpu").eval()
        inputs = sum(1 for _ in module.graph.inputs()) - 1  # without the module itself
    except (RuntimeError, ValueError) as error:
        raise PluginError(
            f"the file is no TorchScript module: {first_line(error)}",
            where=str(path),
            fix="name a file that torch.jit.save wrote, or one that ends in .onnx",
        ) from error
    return _script_network(module, inputs, path)


def read_heads(path: Path, sha256: str, network: str) -> list[Tensor]:
    """The weight of each channel of the five layers, `[C]` float64 each, at least 0.

    Args:
        path: `.safetensors`, `.npz`, or the `.pth` that the authors of LPIPS publish. The weights of
            layer k are called `lin{k}` or `lin{k}.model.1.weight`.
        network: "vgg" or "alex"; says how many channels each layer has.

    Raises:
        PluginError: it cannot be read, has another hash, or holds other weights.
    """
    tensors = read_tensors(read_model_file(path, sha256).content, path)
    heads = []
    for layer, channels in enumerate(CHANNELS[network]):
        weight = next((tensors[n] for n in _head_names(layer) if n in tensors), None)
        if weight is None or weight.numel() != channels:
            found = "none" if weight is None else str(weight.numel())
            raise PluginError(
                f"layer {layer} of {network} needs {channels} weights, the file has {found}",
                where=str(path),
                fix=f"name the weights that belong to `network: {network}`",
            )
        head = weight.reshape(channels).double()
        if not torch.isfinite(head).all() or head.min() < 0:
            raise PluginError(
                f"a weight of layer {layer} is negative or not finite", where=str(path)
            )
        heads.append(head)
    return heads


def _head_names(layer: int) -> tuple[str, str]:
    return f"lin{layer}", f"lin{layer}.model.1.weight"


def _onnx_network(model: OnnxModel) -> Network:
    def run(*images: Tensor) -> list[Tensor]:
        if len(images) != len(model.inputs):
            raise _wrong_inputs(len(images), len(model.inputs), model.path)
        named = {spec.name: image for spec, image in zip(model.inputs, images, strict=True)}
        return list(model.run(named).values())

    return run


def _script_network(module: torch.jit.ScriptModule, inputs: int, path: Path) -> Network:
    def run(*images: Tensor) -> list[Tensor]:
        if len(images) != inputs:
            raise _wrong_inputs(len(images), inputs, path)
        try:
            with torch.no_grad():
                answer: Any = module(*images)
        except RuntimeError as error:
            raise PluginError(
                f"the network failed: {first_line(error)}",
                where=str(path),
                fix="check that it takes images of this size",
            ) from error
        outputs = list(answer) if isinstance(answer, tuple | list) else [answer]
        if not all(isinstance(output, Tensor) for output in outputs):
            raise PluginError(
                "the network's answer is no tensor and no list of them", where=str(path)
            )
        return [output.float() for output in outputs]

    return run


def _wrong_inputs(given: int, taken: int, path: Path) -> PluginError:
    return PluginError(
        f"the network takes {taken} inputs, not {given}",
        where=str(path),
        fix="a network of features takes one image and needs `heads`; one that measures by itself "
        "takes two and needs none",
    )


def read_tensors(content: bytes, path: Path) -> Mapping[str, Tensor]:
    """Plain tensors by name.

    Raises:
        PluginError: the file cannot be read.
    """
    try:
        if path.suffix.lower() == ".safetensors":
            from safetensors.torch import load

            return load(content)
        if path.suffix.lower() == ".npz":
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                return {name: torch.from_numpy(np.asarray(arrays[name])) for name in arrays.files}
        loaded = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        return {name: value for name, value in loaded.items() if isinstance(value, Tensor)}
    except Exception as error:  # three libraries, each with exceptions of its own
        raise PluginError(
            f"the weights cannot be read: {first_line(error)}",
            where=str(path),
            fix="name a .safetensors, .npz or .pth file of plain tensors",
        ) from error
