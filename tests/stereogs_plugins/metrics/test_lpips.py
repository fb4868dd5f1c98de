from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from registry import PluginError, Unavailable
from stereogs_plugins.metrics.lpips import LPIPS, ProperLPIPS, stereogs_register_metrics
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.metrics.lpips_network import (
    CHANNELS,
    Difference,
    Features,
    distance,
    heads,
    onnx_difference,
    onnx_features,
    script,
    sha256,
)

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")


SAVERS: dict[str, Callable[[Path, dict[str, Any]], object]] = {
    ".npz": lambda path, tensors: np.savez(path, **tensors),
    ".pth": lambda path, tensors: torch.save(tensors, path),
    ".safetensors": lambda path, tensors: save_file(tensors, path),
}


def save_heads(path: Path, names: str = "lin{}", **changed: Tensor) -> Path:
    tensors = {names.format(k): torch.from_numpy(head) for k, head in enumerate(heads())}
    if "model" in names:
        tensors = {name: head.view(1, -1, 1, 1) for name, head in tensors.items()}
    SAVERS[path.suffix](path, tensors | changed)
    return path


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return onnx_features(tmp_path_factory.mktemp("network") / "alex.onnx")


@pytest.fixture(scope="module")
def scripted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return script(tmp_path_factory.mktemp("scripted") / "alex.pt", Features())


def settings(network: Path, weights: Path | None = None) -> dict[str, Any]:
    chosen: dict[str, Any] = {"network": "alex", "file": network, "sha256": sha256(network)}
    if weights is not None:
        chosen |= {"heads": weights, "heads_sha256": sha256(weights)}
    return chosen


def images() -> tuple[Tensor, Tensor]:
    """Two that differ a little everywhere."""
    first, noise = torch.rand(2, 32, 64, 3, generator=torch.Generator().manual_seed(1))
    return first, 0.8 * first + 0.2 * noise


def test_are_offered() -> None:
    assert offered(stereogs_register_metrics) == {"lpips": LPIPS, "lpips_proper": ProperLPIPS}


@pytest.mark.parametrize("ending", SAVERS)
@pytest.mark.parametrize("names", ["lin{}", "lin{}.model.1.weight"])
def test_agrees_with_numpy(network: Path, tmp_path: Path, ending: str, names: str) -> None:
    weights = save_heads(tmp_path / f"heads{ending}", names)
    first, second = images()
    score = build(LPIPS, **settings(network, weights)).measure(first, second, None)
    expected = distance(first.double().numpy(), second.double().numpy())
    assert expected > 0.01
    assert score == pytest.approx(expected, rel=1e-5)


def test_features_shorter_than_epsilon_have_little_direction(tmp_path: Path) -> None:
    network = onnx_features(tmp_path / "faint.onnx", scale=1e-10)
    first, second = images()
    chosen = settings(network, save_heads(tmp_path / "heads.npz"))
    score = build(LPIPS, **chosen).measure(first, second, None)
    arrays = first.double().numpy(), second.double().numpy()
    assert score == pytest.approx(distance(*arrays, scale=1e-10), rel=1e-5)
    assert isinstance(score, float)
    assert score < 0.95 * distance(*arrays)


def test_torchscript_gives_the_same(network: Path, scripted: Path, tmp_path: Path) -> None:
    weights = save_heads(tmp_path / "heads.npz")
    by_onnx, by_script = (
        build(LPIPS, **settings(file, weights)).measure(*images(), None)
        for file in (network, scripted)
    )
    assert by_script == pytest.approx(by_onnx, rel=1e-5)


def test_the_proper_range_is_minus_one_to_one(network: Path, tmp_path: Path) -> None:
    chosen = settings(network, save_heads(tmp_path / "heads.npz"))
    first, second = images()
    proper = build(ProperLPIPS, **chosen).measure(first, second, None)
    expected = distance(2 * first.double().numpy() - 1, 2 * second.double().numpy() - 1)
    assert proper == pytest.approx(expected, rel=1e-5)
    raw = build(LPIPS, **chosen).measure(first, second, None)
    assert proper != pytest.approx(raw, rel=0.01)


def test_equal_images_have_no_distance(network: Path, tmp_path: Path) -> None:
    metric = build(LPIPS, **settings(network, save_heads(tmp_path / "heads.npz")))
    first, _ = images()
    assert metric.measure(first, first, None) == 0


def test_what_lies_outside_the_mask_is_white_in_both(network: Path, tmp_path: Path) -> None:
    metric = build(LPIPS, **settings(network, save_heads(tmp_path / "heads.npz")))
    first, second = images()
    mask = torch.zeros(32, 64, dtype=torch.bool)
    mask[8:24, 16:40] = True
    white, other = (
        image.where(mask[..., None], torch.ones(())).double().numpy() for image in (first, second)
    )
    expected = distance(white, other)
    assert metric.measure(first, second, mask) == pytest.approx(expected, rel=1e-5)


def test_png8_compares_what_a_png_would_hold(network: Path, tmp_path: Path) -> None:
    chosen = settings(network, save_heads(tmp_path / "heads.npz"))
    first, second = images()
    stored, other = ((i.double() * 255).round().numpy() / 255 for i in (first, second))
    score = build(LPIPS, quantize="png8", **chosen).measure(first, second, None)
    assert score == pytest.approx(distance(stored, other), rel=1e-6)


@pytest.mark.parametrize("kind", ["onnx", "script"])
def test_a_file_may_measure_by_itself(tmp_path: Path, kind: str) -> None:
    file = (
        onnx_difference(tmp_path / "whole.onnx")
        if kind == "onnx"
        else script(tmp_path / "whole.pt", Difference())
    )
    first, second = images()
    expected = float((first - second).abs().mean())
    chosen = settings(file)
    assert build(LPIPS, **chosen).measure(first, second, None) == pytest.approx(expected, rel=1e-5)
    proper = build(ProperLPIPS, **chosen).measure(first, second, None)
    assert proper == pytest.approx(2 * expected, rel=1e-5)


def test_without_a_file_it_says_so(
    network: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    answer = build(LPIPS).measure(*images(), None)
    assert isinstance(answer, Unavailable)
    assert "`stereogs models get lpips`" in answer.reason
    chosen = settings(network, save_heads(tmp_path / "heads.npz"))
    for missing in ("file", "heads"):
        metric = build(LPIPS, **{**chosen, missing: tmp_path / "gone"})
        answer = metric.measure(*images(), None)
        assert isinstance(answer, Unavailable)
        assert "gone" in answer.reason


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"file": Path("a.onnx")}, "`file` and `sha256` require each other"),
        ({"sha256": "0" * 64}, "`file` and `sha256` require each other"),
        ({"heads": Path("a.npz")}, "`heads` and `heads_sha256` require each other"),
        ({"heads": Path("a.npz"), "heads_sha256": "0" * 64}, "the network is missing"),
        ({"file": Path("a.onnx"), "sha256": "0" * 63}, "pattern"),
        ({"network": "squeeze"}, "'vgg' or 'alex'"),
    ],
)
def test_settings_that_do_not_fit(given: dict[str, Any], message: str) -> None:
    with pytest.raises(pydantic.ValidationError, match=message):
        LPIPS.Settings(**given)


def refusal(chosen: dict[str, Any]) -> str:
    with pytest.raises(PluginError) as caught:
        build(LPIPS, **chosen).measure(*images(), None)
    assert caught.value.where
    return caught.value.what


@pytest.mark.parametrize("which", ["sha256", "heads_sha256"])
@pytest.mark.parametrize("kind", ["network", "scripted"])
def test_another_hash_is_refused(
    request: pytest.FixtureRequest, tmp_path: Path, which: str, kind: str
) -> None:
    chosen = settings(request.getfixturevalue(kind), save_heads(tmp_path / "heads.npz"))
    assert "SHA-256" in refusal({**chosen, which: "0" * 64})


def test_a_hash_may_be_written_in_capitals(network: Path, tmp_path: Path) -> None:
    chosen = settings(network, save_heads(tmp_path / "heads.npz"))
    shouted = {**chosen, "sha256": chosen["sha256"].upper()}
    assert isinstance(build(LPIPS, **shouted).measure(*images(), None), float)


def test_files_that_hold_something_else(network: Path, tmp_path: Path) -> None:
    good = save_heads(tmp_path / "heads.npz")
    junk = tmp_path / "junk.pt"
    junk.write_bytes(b"PK\x03\x04 no archive")
    assert "not a TorchScript module" in refusal(settings(junk, good))
    for ending in SAVERS:
        broken = tmp_path / f"broken{ending}"
        broken.write_bytes(b"no weights")
        assert "cannot be read" in refusal(settings(network, broken))
    negative = save_heads(tmp_path / "negative.npz", lin2=-torch.ones(CHANNELS[2]))
    assert "negative or not finite" in refusal(settings(network, negative))
    short = save_heads(tmp_path / "short.npz", lin4=torch.ones(255))
    assert "layer 4 of alex needs 256 weights, the file has 255" in refusal(
        settings(network, short)
    )
    other = {**settings(network, good), "network": "vgg"}
    assert "layer 1 of vgg needs 128 weights" in refusal(other)


def test_a_pickle_of_anything_but_tensors_is_refused(network: Path, tmp_path: Path) -> None:
    path = tmp_path / "heads.pth"
    torch.save({"lin0": Path("anything")}, path)
    assert "cannot be read" in refusal(settings(network, path))


def test_networks_of_another_kind(network: Path, tmp_path: Path) -> None:
    weights = save_heads(tmp_path / "heads.npz")
    whole = onnx_difference(tmp_path / "whole.onnx")
    assert "takes 2 inputs, not 1" in refusal(settings(whole, weights))
    assert "takes 1 inputs, not 2" in refusal(settings(network))
    module = script(tmp_path / "whole.pt", Difference())
    assert "takes 2 inputs, not 1" in refusal(settings(module, weights))
    ones: dict[str, Any] = {f"lin{k}": torch.ones(c) for k, c in VGG.items()}
    vgg = save_heads(tmp_path / "vgg.npz", **ones)
    assert "features have the shapes" in refusal({**settings(network, vgg), "network": "vgg"})


VGG = dict(enumerate((64, 128, 256, 512, 512)))


class Untidy(torch.nn.Module):
    """Answers two images with two numbers, or fails on wide ones."""

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        if first.shape[3] > 100:
            return first @ second
        return torch.stack([first.mean(), second.mean()])


def test_answers_that_are_none(tmp_path: Path) -> None:
    module = script(tmp_path / "untidy.pt", Untidy())
    assert "one number" in refusal(settings(module))
    wide = torch.rand(8, 128, 3)
    with pytest.raises(PluginError, match="the network failed"):
        build(LPIPS, **settings(module)).measure(wide, wide, None)
