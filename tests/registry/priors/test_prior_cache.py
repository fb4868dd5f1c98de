"""The same question is answered from disk; another one, or another code's, is asked anew."""

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
from registry.priors.prior_cache import PriorCache, code_digest, source_digest
from registry.testing import tiny_scene

from .toy_priors import Brightness, Middle, built


def test_the_same_question_is_answered_from_disk_bit_for_bit(cache: Path) -> None:
    scene = tiny_scene()
    first, second = built(Middle), built(Middle)
    before = first.depths(scene.train, scene.bounds)
    again = second.depths(scene.train, scene.bounds)
    assert (first.asked, second.asked) == (1, 0)
    for one, other in zip(before, again, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.valid, other.valid)
        assert torch.equal(one.confidence, other.confidence)


def test_another_question_is_asked_anew(cache: Path) -> None:
    scene = tiny_scene()
    prior = built(Middle)
    prior.depths(scene.train, scene.bounds)
    prior.depths(scene.train, (scene.bounds[0], scene.bounds[1] * 2))
    prior.depths(scene.train[::-1], scene.bounds)
    assert prior.asked == 3
    mono = built(Brightness)
    mono.inverse_depth_of(scene.train[0])
    changed = scene.train[0].image.clone()
    changed[3, 3, 1] = torch.nextafter(changed[3, 3, 1], torch.tensor(1.0))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    assert mono.asked == 2


def test_cached_answers_can_be_looked_at(cache: Path) -> None:
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


def test_a_damaged_answer_is_reported_and_replaced(
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
    assert prior.asked == 2
    prior.inverse_depth_of(view)
    assert prior.asked == 2


def test_a_cache_that_cannot_be_written_costs_a_warning_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        built(Brightness).inverse_depth_of(tiny_scene().train[0])
    assert "could not be cached" in caplog.text


def test_a_full_disk_costs_a_warning_only(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # as good as a full disk
    try:
        PriorCache("full").save("0" * 32, {"answer": torch.zeros(1000)}, {}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "could not be cached" in caplog.text
    assert PriorCache("full").load("0" * 32) is None


def test_the_code_of_the_component_is_part_of_the_question() -> None:
    assert code_digest(Middle) != code_digest(Brightness)
    assert code_digest(Middle) == code_digest(Middle)


@pytest.mark.parametrize("listed", ["top_level.txt", "RECORD"])
def test_the_code_of_all_that_its_package_installs_is_part_of_the_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listed: str
) -> None:
    """Two modules side by side: a package that is no folder. A third belongs to somebody else."""
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


def test_an_answer_about_an_image_is_not_kept(cache: Path) -> None:
    prior, image = built(Brightness), tiny_scene().train[0].image
    assert torch.equal(prior.inverse_depth(image), prior.inverse_depth(image))
    assert prior.asked == 2
    assert not cache.exists() or not list(cache.rglob("*.safetensors"))
