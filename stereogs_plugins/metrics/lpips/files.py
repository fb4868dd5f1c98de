"""Files of LPIPS: a network as ONNX or TorchScript, and the weights of its five layers.

Files are never downloaded, and only plain tensors are unpickled.
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
"""Takes one image `[1, 3, H, W]` float32 per input of the file; returns all outputs."""

CHANNELS = {"vgg": (64, 128, 256, 512, 512), "alex": (64, 192, 384, 256, 256)}
"""Channels of the five layers that LPIPS compares, by network."""


def read_network(path: Path, sha256: str) -> Network:
    """Load an `.onnx` file with onnxruntime, any other as TorchScript.

    Raises:
        PluginError: it cannot be read, has another hash, or has another format.
    """
    if path.suffix.lower() == ".onnx":
        return _onnx_network(OnnxModel(path, sha256, "cpu"))
    content = read_model_file(path, sha256).content
    try:
        module = torch.jit.load(io.BytesIO(content), map_location="cpu").eval()
        inputs = sum(1 for _ in module.graph.inputs()) - 1  # excluding the module itself
    except (RuntimeError, ValueError) as error:
        raise PluginError(
            f"the file is not a TorchScript module: {first_line(error)}",
            where=str(path),
            fix="use a file written by torch.jit.save, or one that ends in .onnx",
        ) from error
    return _script_network(module, inputs, path)


def read_heads(path: Path, sha256: str, network: str) -> list[Tensor]:
    """Load the weight of each channel of the five layers, `[C]` float64 each, at least 0.

    Args:
        path: `.safetensors`, `.npz`, or the `.pth` published by the authors of LPIPS. The weights of
            layer k are named `lin{k}` or `lin{k}.model.1.weight`.
        network: "vgg" or "alex"; determines the number of channels per layer.

    Raises:
        PluginError: it cannot be read, has another hash, or contains other weights.
    """
    tensors = read_tensors(read_model_file(path, sha256).content, path)
    heads = []
    for layer, channels in enumerate(CHANNELS[network]):
        weight = tensors.get(f"lin{layer}", tensors.get(f"lin{layer}.model.1.weight"))
        if weight is None or weight.numel() != channels:
            found = "none" if weight is None else str(weight.numel())
            raise PluginError(
                f"layer {layer} of {network} needs {channels} weights, the file has {found}",
                where=str(path),
                fix=f"use the weights for `network: {network}`",
            )
        head = weight.reshape(channels).double()
        if not torch.isfinite(head).all() or head.min() < 0:
            raise PluginError(
                f"a weight of layer {layer} is negative or not finite", where=str(path)
            )
        heads.append(head)
    return heads


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
        except (RuntimeError, torch.jit.Error) as error:
            reason = str(error).strip().rpartition("\n")[2]  # after the script's own traceback
            raise PluginError(
                f"the network failed: {reason}",
                where=str(path),
                fix="check that it takes images of this size",
            ) from error
        outputs = list(answer) if isinstance(answer, tuple | list) else [answer]
        if not all(isinstance(output, Tensor) for output in outputs):
            raise PluginError(
                "the network's output is neither a tensor nor a list of tensors", where=str(path)
            )
        return [output.float() for output in outputs]

    return run


def _wrong_inputs(given: int, taken: int, path: Path) -> PluginError:
    return PluginError(
        f"the network takes {taken} inputs, not {given}",
        where=str(path),
        fix="a feature network takes one image and requires `heads`; one that computes the distance "
        "takes two images, without `heads`",
    )


def read_tensors(content: bytes, path: Path) -> Mapping[str, Tensor]:
    """Load plain tensors by name.

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
    except Exception as error:  # three libraries, each with its own exceptions
        raise PluginError(
            f"the weights cannot be read: {first_line(error)}",
            where=str(path),
            fix="use a .safetensors, .npz or .pth file of plain tensors",
        ) from error
