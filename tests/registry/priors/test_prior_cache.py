"""Estimates are read from disk for equal inputs and code, and computed again otherwise."""

from __future__ import annotations

import json
import logging
import resource
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from core_rasterizer import Device
from registry import Context, Settings, TrainingView
from registry.priors import MonocularDepthPrior
from registry.priors.prior_cache import load_estimate, save_estimate
from registry.testing import tiny_scene
from tests.registry.priors.toy_priors import Brightness, Middle, built


def test_equal_inputs_are_read_from_disk_bit_for_bit(cache: Path) -> None:
    scene = tiny_scene()
    first, second = built(Middle), built(Middle)
    before = first.depths(scene.train, scene.bounds)
    again = second.depths(scene.train, scene.bounds)
    assert (first.calls, second.calls) == (1, 0)
    for one, other in zip(before, again, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.valid, other.valid)
        assert torch.equal(one.confidence, other.confidence)


def test_other_inputs_are_computed_again(cache: Path) -> None:
    scene = tiny_scene()
    prior = built(Middle)
    prior.depths(scene.train, scene.bounds)
    prior.depths(scene.train, (scene.bounds[0], scene.bounds[1] * 2))
    prior.depths(scene.train[::-1], scene.bounds)
    assert prior.calls == 3
    mono = built(Brightness)
    mono.inverse_depth_of(scene.train[0])
    changed = scene.train[0].image.clone()
    changed[3, 3, 1] = torch.nextafter(changed[3, 3, 1], torch.tensor(1.0))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    assert mono.calls == 2


class LevelSettings(Settings):
    level: int = 0


class Level(MonocularDepthPrior[LevelSettings]):
    calls = 0

    def estimate(self, image: torch.Tensor) -> torch.Tensor:
        self.calls += 1
        return image.mean(dim=2) + self.settings.level


VIEW = tiny_scene().train[0]
CHANGED_VIEWS: dict[str, TrainingView] = {
    "alpha": replace(VIEW, alpha=torch.ones(24, 32)),
    "mask": replace(VIEW, mask=torch.ones(24, 32, dtype=torch.bool)),
    "intrinsics": replace(VIEW, camera=replace(VIEW.camera, cx=VIEW.camera.cx + 1e-9)),
    "pose": replace(VIEW, camera=VIEW.camera.shifted_right(1e-9)),
}


@pytest.mark.parametrize("changed", ["settings", "code", *CHANGED_VIEWS])
def test_each_part_of_the_key_counts_alone(
    cache: Path, device: Device, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    def calls(view: TrainingView, level: int = 0) -> int:
        prior = Level(LevelSettings(level=level), Context("level", 0, device))
        prior.inverse_depth_of(view)
        return prior.calls

    assert [calls(VIEW), calls(VIEW)] == [1, 0]
    if changed == "code":
        monkeypatch.setattr("registry.priors.prior_cache.package_digest", lambda *_: "other")
    assert calls(CHANGED_VIEWS.get(changed, VIEW), int(changed == "settings")) == 1


def test_cached_estimates_have_images(cache: Path) -> None:
    scene = tiny_scene()
    built(Middle, "sweep").depths(scene.train, scene.bounds)
    (folder,) = (cache / "sweep").iterdir()
    assert sorted(path.name for path in folder.iterdir()) == [
        "answer.json",
        "answer.safetensors",
        "checksum.txt",
        "view0_depth.png",
        "view2_depth.png",
    ]
    assert json.loads((folder / "answer.json").read_text())["views"] == ["view0", "view2"]
    assert set(load_file(folder / "answer.safetensors")) == {
        f"{i}/{name}" for i in range(2) for name in ("depth", "valid", "confidence")
    }


def test_a_damaged_entry_is_reported_and_replaced(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    view = tiny_scene().train[0]
    prior = built(Brightness)
    answer = prior.inverse_depth_of(view)
    (file,) = cache.rglob("answer.safetensors")
    file.write_bytes(file.read_bytes()[:40])
    with caplog.at_level(logging.WARNING):
        assert torch.equal(prior.inverse_depth_of(view), answer)
    assert "damaged" in caplog.text
    assert prior.calls == 2
    prior.inverse_depth_of(view)
    assert prior.calls == 2


def test_a_read_only_cache_gives_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        built(Brightness).inverse_depth_of(tiny_scene().train[0])
    assert "could not be cached" in caplog.text


def test_a_full_disk_gives_a_warning(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # acts like a full disk
    try:
        save_estimate("full", "0" * 32, {"answer": torch.zeros(1000)}, {}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "could not be cached" in caplog.text
    assert load_estimate("full", "0" * 32) is None


def test_estimates_for_images_are_not_cached(cache: Path) -> None:
    prior, image = built(Brightness), tiny_scene().train[0].image
    assert torch.equal(prior.inverse_depth(image), prior.inverse_depth(image))
    assert prior.calls == 2
    assert not cache.exists() or not list(cache.rglob("*.safetensors"))


class FileSettings(Settings):
    file: Path


class Filed(MonocularDepthPrior[FileSettings]):
    """Has no fingerprint of its own."""

    calls = 0

    def estimate(self, image: torch.Tensor) -> torch.Tensor:
        self.calls += 1
        return image.mean(dim=2)


def test_a_model_file_with_other_content_is_noticed(
    cache: Path, tmp_path: Path, device: Device
) -> None:
    file = tmp_path / "model.onnx"
    calls = []
    for content in (b"one", b"one", b"other"):
        file.write_bytes(content)
        prior = Filed(FileSettings(file=file), Context("filed", 0, device))
        prior.inverse_depth_of(tiny_scene().train[0])
        calls.append(prior.calls)
    assert calls == [1, 0, 1]


class Opening(MonocularDepthPrior[FileSettings]):
    """Opens models that no setting names: the first as an attribute, or in its first call in a dictionary."""

    lazy = False

    def __init__(self, settings: FileSettings, context: Context) -> None:
        super().__init__(settings, context)
        self.models: dict[str, Opened] = {}
        if not self.lazy:
            self.models["depth"] = Opened(settings.file)

    def estimate(self, image: torch.Tensor) -> torch.Tensor:
        self.models["depth"] = Opened(self.settings.file)
        return image.mean(dim=2) * self.models["depth"].factor


class OpeningLate(Opening):
    lazy = True


class Opened:
    """A model file that holds a number."""

    def __init__(self, file: Path) -> None:
        content = (file.parent / "hidden.onnx").read_bytes()
        self.sha256, self.factor = sha256(content).hexdigest(), float(content)


@pytest.mark.parametrize("kind", [Opening, OpeningLate])
def test_a_model_that_no_setting_names_is_noticed(
    cache: Path, tmp_path: Path, device: Device, kind: type[Opening]
) -> None:
    means = []
    for factor in (b"1", b"3"):
        (tmp_path / "hidden.onnx").write_bytes(factor)
        prior = kind(FileSettings(file=tmp_path / "none"), Context("opening", 0, device))
        means.append(float(prior.inverse_depth_of(tiny_scene().train[0]).mean()))
    assert means[1] == pytest.approx(3 * means[0])
