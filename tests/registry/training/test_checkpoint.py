"""Checkpoints are complete or absent, the previous one is kept, and every bit is verified."""

from __future__ import annotations

import json
import logging
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from registry import RunError
from registry.training.checkpoint import (
    Checkpoint,
    explain_misfit,
    load_checkpoint,
    read_checkpoint,
    save_checkpoint,
)
from tests.host import write_json

FIRST, SECOND = "iteration-0000010", "iteration-0000020"


def checkpoint(iteration: int) -> Checkpoint:
    tensors = {"model/means": torch.full((2, 3), float(iteration)), "views/left": torch.arange(3)}
    return Checkpoint(iteration, 1.5, tensors, "name: x\n", "ab", {"note": [1]})


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_checkpoints_are_loaded_and_two_are_kept(tmp_path: Path) -> None:
    for iteration in (5, 10, 20):
        save_checkpoint(checkpoint(iteration), tmp_path / "new")
    assert names(tmp_path / "new") == [FIRST, SECOND]
    loaded = load_checkpoint(tmp_path / "new")
    assert (loaded.iteration, loaded.seconds, loaded.run) == (20, 1.5, "ab")
    assert (loaded.pipeline, loaded.notes) == ("name: x\n", {"note": [1]})
    assert list(loaded.part("model")) == ["means"]
    assert torch.equal(loaded.part("views")["left"], torch.arange(3))


def test_tensors_that_share_memory_are_saved_separately(tmp_path: Path) -> None:
    rows = torch.arange(6.0).reshape(2, 3)
    shared = {"all": rows, "same": rows, "second": rows[1], "turned": rows.T, "none": rows[:0]}
    tensors = {f"maps/{name}": value for name, value in shared.items()}
    save_checkpoint(Checkpoint(1, 0.0, tensors, "name: x\n"), tmp_path)
    loaded = load_checkpoint(tmp_path).part("maps")
    assert loaded.keys() == shared.keys()
    assert all(torch.equal(loaded[name], value) for name, value in shared.items())


@contextmanager
def full_disk(free: int) -> Iterator[None]:
    """Limit files to `free` bytes: the system refuses larger writes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("free", [0, 100, 300])
def test_a_full_disk_leaves_earlier_checkpoints_intact(tmp_path: Path, free: int) -> None:
    """No byte fits, or the tensors are cut off, or the manifest is."""
    with pytest.raises(RunError, match="cannot be written") as caught, full_disk(free):
        save_checkpoint(checkpoint(10), tmp_path)
    assert "resume" not in caught.value.fix
    assert names(tmp_path) == []
    save_checkpoint(checkpoint(10), tmp_path)
    with pytest.raises(RunError, match="cannot be written") as caught, full_disk(free):
        save_checkpoint(checkpoint(20), tmp_path)
    assert f"then `stereogs resume {tmp_path.parent}`" in caught.value.fix
    assert names(tmp_path) == [FIRST]
    assert load_checkpoint(tmp_path).iteration == 10


def flipped(file: Path, bit: int) -> None:
    """Flip one bit of a file."""
    data = bytearray(file.read_bytes())
    data[bit // 8 % len(data)] ^= 1 << bit % 8
    file.write_bytes(data)


@pytest.mark.parametrize("name", ["manifest.json", "pipeline.yaml", "tensors.safetensors"])
def test_every_flipped_bit_is_detected(tmp_path: Path, name: str) -> None:
    save_checkpoint(checkpoint(10), tmp_path)
    file = tmp_path / FIRST / name
    bits = 8 * file.stat().st_size
    for bit in range(0, bits, max(1, bits // 97)):
        flipped(file, bit)
        with pytest.raises(RunError, match=r"damaged|has format"):
            load_checkpoint(tmp_path)
        flipped(file, bit)
    assert load_checkpoint(tmp_path).iteration == 10


def forged(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Return a function that edits the manifest, but not its hash."""

    def damage(place: Path) -> None:
        manifest = json.loads((place / "manifest.json").read_text())
        change(manifest)
        write_json(place / "manifest.json", manifest)

    return damage


def without(name: str) -> Callable[[Path], None]:
    return lambda place: (place / name).unlink()


def holding(name: str, content: bytes) -> Callable[[Path], None]:
    def damage(place: Path) -> None:
        (place / name).write_bytes(content)

    return damage


DAMAGE: dict[str, Callable[[Path], None]] = {
    "another iteration": forged(lambda m: m.update(iteration=1_000_000_000)),
    "negative seconds": forged(lambda m: m.update(seconds=-1)),
    "no hash": forged(lambda m: m.pop("sha256")),
    "no files": forged(lambda m: m.pop("files")),
    "no manifest": without("manifest.json"),
    "no tensors": without("tensors.safetensors"),
    "no pipeline": without("pipeline.yaml"),
    "empty tensors": holding("tensors.safetensors", b""),
    "wild tensors": holding("tensors.safetensors", b"\xff" * 100),
    "half a manifest": holding("manifest.json", b'{"format": 2, "it'),
    "a list": holding("manifest.json", b"[]"),
    "nested": holding("manifest.json", b"[" * 100_000),
    "no text": holding("manifest.json", b"\xff\xfe"),
    "an older one": holding("manifest.json", b'{"format": 1}'),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=list(DAMAGE))
def test_damage_is_explained_and_the_previous_checkpoint_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[Path], None]
) -> None:
    save_checkpoint(checkpoint(20), tmp_path)
    damage(tmp_path / SECOND)
    with pytest.raises(RunError) as caught:
        load_checkpoint(tmp_path)
    assert SECOND in caught.value.where
    assert caught.value.fix
    save_checkpoint(checkpoint(10), tmp_path)
    assert names(tmp_path) == [FIRST], "what lies ahead of a run that went back is superseded"
    save_checkpoint(checkpoint(20), tmp_path)
    damage(tmp_path / SECOND)
    with caplog.at_level(logging.WARNING):
        assert load_checkpoint(tmp_path).iteration == 10
    assert SECOND in caplog.text
    assert "continuing from the previous one, after iteration 10" in caplog.text


def test_a_second_checkpoint_of_an_iteration_gets_a_number(tmp_path: Path) -> None:
    for iteration in (9_999_999, 10_000_000):
        save_checkpoint(checkpoint(iteration), tmp_path)
    assert load_checkpoint(tmp_path).iteration == 10_000_000
    for iteration in (10, 20):
        save_checkpoint(checkpoint(iteration), tmp_path)
    flipped(tmp_path / SECOND / "tensors.safetensors", 800)
    save_checkpoint(checkpoint(20), tmp_path)
    assert names(tmp_path) == [SECOND, f"{SECOND}-2"]
    assert load_checkpoint(tmp_path).iteration == 20
    assert read_checkpoint(tmp_path / f"{SECOND}-2").seconds == 1.5


def test_no_checkpoint(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(RunError, match="no checkpoint"):
            load_checkpoint(folder)


def test_errors_of_a_mismatch_name_the_checkpoint(tmp_path: Path) -> None:
    with (
        pytest.raises(RunError, match="match this pipeline: KeyError: 'screen'") as caught,
        explain_misfit(tmp_path),
    ):
        _ = checkpoint(1).part("statistics")["screen"]
    assert caught.value.where == str(tmp_path)
    with pytest.raises(RunError, match="too few") as told, explain_misfit(tmp_path):
        raise RunError("too few", where="views")
    assert told.value.where == f"views; from {tmp_path}"
