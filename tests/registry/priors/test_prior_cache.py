"""Estimates are read from disk for equal inputs and code, and computed again otherwise."""

from __future__ import annotations

import json
import logging
import resource
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from registry.plugins.discovery import GROUP
from registry.priors.prior_cache import code_digest, load_estimate, save_estimate, source_digest
from registry.testing import tiny_scene

from .toy_priors import Brightness, Middle, built


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


def test_the_key_contains_the_code_of_the_component() -> None:
    assert code_digest(Middle) != code_digest(Brightness)
    assert code_digest(Middle) == code_digest(Middle)


@pytest.mark.parametrize("listed", ["top_level.txt", "RECORD"])
def test_the_key_contains_the_code_of_the_whole_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listed: str
) -> None:
    """A package of two top-level modules; a third module belongs to another package."""
    name = listed.partition(".")[0].lower()
    modules = (f"flat_{name}", f"flat_{name}_helper")
    for module in (*modules, f"other_{name}"):
        (tmp_path / f"{module}.py").write_text("FACTOR = 1\n")
    metadata = tmp_path / f"flat_{name}-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: flat-{name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[{GROUP}]\nflat = flat_{name}\n")
    lines = modules if listed == "top_level.txt" else [f"{module}.py,," for module in modules]
    (metadata / listed).write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(tmp_path)
    component = type("Flat", (), {"__module__": f"flat_{name}"})

    def digest() -> str:
        source_digest.cache_clear()
        return code_digest(component)

    before = digest()
    (tmp_path / f"other_{name}.py").write_text("FACTOR = 2\n")
    assert digest() == before
    (tmp_path / f"flat_{name}_helper.py").write_text("FACTOR = 2\n")
    assert digest() != before


def test_estimates_for_images_are_not_cached(cache: Path) -> None:
    prior, image = built(Brightness), tiny_scene().train[0].image
    assert torch.equal(prior.inverse_depth(image), prior.inverse_depth(image))
    assert prior.calls == 2
    assert not cache.exists() or not list(cache.rglob("*.safetensors"))
