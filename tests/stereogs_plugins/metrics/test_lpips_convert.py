"""ONNX files made from torchvision's weights, against torch's own layers in torchvision's order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
import yaml
from torch import Tensor, nn

from stereogs_plugins.metrics.lpips import LPIPS
from stereogs_plugins.metrics.lpips.convert import main
from stereogs_plugins.metrics.lpips.known_files import KNOWN, NetworkName
from tests.data import models_folder
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.metrics.lpips_network import sha256

VGG = (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512)
"""Channels of the convolutions; 0 is a max pooling."""
COMPARED = {"vgg": (3, 8, 15, 22, 29), "alex": (1, 4, 7, 9, 11)}
"""The ReLUs of torchvision's `features` that LPIPS compares."""
NETWORKS = [pytest.param("vgg", marks=pytest.mark.proof), "alex"]


def torchvisions(network: NetworkName) -> nn.Sequential:
    """The layers of torchvision's `features`, with random weights."""
    torch.manual_seed(3)
    if network == "alex":
        return nn.Sequential(
            *(nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(192, 384, 3, padding=1), nn.ReLU()),
            *(nn.Conv2d(384, 256, 3, padding=1), nn.ReLU()),
            *(nn.Conv2d(256, 256, 3, padding=1), nn.ReLU()),
        )
    layers: list[nn.Module] = []
    channels = 3
    for item in VGG:
        if item:
            layers += [nn.Conv2d(channels, item, 3, padding=1), nn.ReLU()]
            channels = item
        else:
            layers.append(nn.MaxPool2d(2, 2))
    return nn.Sequential(*layers)


def maps_of(features: nn.Sequential, network: NetworkName, image: Tensor) -> list[Tensor]:
    maps = []
    for number, layer in enumerate(features):
        image = layer(image)
        if number in COMPARED[network]:
            maps.append(image.detach())
    return maps


def save(features: nn.Sequential, path: Path) -> Path:
    """As torchvision's file: with the layers behind the features too."""
    tensors = {f"features.{name}": values for name, values in features.state_dict().items()}
    torch.save(tensors | {"classifier.0.weight": torch.zeros(2, 2)}, path)
    return path


def run(file: Path, image: Tensor) -> list[np.ndarray]:
    answers: list[np.ndarray] = onnxruntime.InferenceSession(file).run(
        None, {"image": image.numpy()}
    )
    return answers


@pytest.mark.parametrize("network", NETWORKS)
def test_the_file_answers_what_torchs_layers_do(network: NetworkName, tmp_path: Path) -> None:
    features = torchvisions(network)
    weights, out = save(features, tmp_path / "weights.pth"), tmp_path / "network.onnx"
    assert main([network, str(weights), str(out)]) == 0
    image = torch.randn(1, 3, 64, 80, generator=torch.Generator().manual_seed(1))
    expected = maps_of(features, network, image)
    answers = run(out, image)
    assert len(answers) == 5
    for answer, truth in zip(answers, expected, strict=True):
        np.testing.assert_allclose(answer, truth.numpy(), rtol=1e-4, atol=1e-5)
        assert answer.any()


def test_what_is_printed_is_a_metric_that_measures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = save(torchvisions("alex"), tmp_path / "weights.pth")
    assert main(["alex", str(weights), str(tmp_path / "network.onnx")]) == 0
    (printed,) = yaml.safe_load(capsys.readouterr().out)
    assert printed.pop("use") == "lpips"
    heads = tmp_path / "heads.npz"
    ones: dict[str, Any] = {f"lin{k}": np.ones(c) for k, c in enumerate((64, 192, 384, 256, 256))}
    np.savez(heads, **ones)
    metric = build(LPIPS, **printed, heads=heads, heads_sha256=sha256(heads))
    image = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(2))
    assert metric.measure(image, image, None) == 0
    distance = metric.measure(image, 1 - image, None)
    assert isinstance(distance, float)
    assert distance > 0


@pytest.mark.parametrize("network", NETWORKS)
def test_published_weights_give_the_features_of_the_known_file(
    network: NetworkName, tmp_path: Path
) -> None:
    """The known file's weights in torchvision's form become a file that answers the same."""
    onnx = pytest.importorskip("onnx")
    known = models_folder("lpips_backbones").parent / KNOWN[network].network
    constants = {c.name: onnx.numpy_helper.to_array(c) for c in onnx.load(known).graph.initializer}
    numbers = [n for n, layer in enumerate(torchvisions(network)) if isinstance(layer, nn.Conv2d)]
    tensors = {}
    for count, number in enumerate(numbers):
        kernel = constants[name if (name := f"w.{count}") in constants else f"{name}_h"].astype(
            np.float32
        )
        tensors[f"features.{number}.weight"] = torch.from_numpy(kernel)
        tensors[f"features.{number}.bias"] = torch.from_numpy(constants[f"b.{count}"].copy())
    torch.save(tensors, tmp_path / "weights.pth")
    assert main([network, str(tmp_path / "weights.pth"), str(tmp_path / "network.onnx")]) == 0
    image = torch.randn(1, 3, 48, 64, generator=torch.Generator().manual_seed(1))
    made, published = run(tmp_path / "network.onnx", image), run(known, image)
    for answer, truth in zip(made, published, strict=True):
        np.testing.assert_allclose(answer, truth, rtol=1e-4, atol=1e-4)


def test_other_weights_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = save(torchvisions("alex"), tmp_path / "weights.pth")
    assert main(["vgg", str(weights), str(tmp_path / "network.onnx")]) == 2
    said = capsys.readouterr().err
    assert "features.0.weight must be [64, 3, 3, 3]" in said
    assert "has the shape [64, 3, 11, 11]" in said
    (tmp_path / "text.pth").write_text("no weights")
    assert main(["vgg", str(tmp_path / "text.pth"), str(tmp_path / "network.onnx")]) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "network.onnx").exists()
