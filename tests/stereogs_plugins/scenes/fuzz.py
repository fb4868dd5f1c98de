"""Damage data sets at random and hold loaders to the rule: a valid scene, or an explained error.

python -m tests.stereogs_plugins.scenes.fuzz 100000 [format ...]
"""

from __future__ import annotations

import io
import random
import re
import struct
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from core_rasterizer import ExplainedError
from registry import Scene, SceneLoader
from stereogs_plugins.scenes.blender import BlenderScene
from stereogs_plugins.scenes.colmap import ColmapScene
from stereogs_plugins.scenes.dtu import DTUScene
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.nerfstudio import NerfstudioScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    World,
    write_blender,
    write_colmap,
    write_dtu,
    write_llff,
    write_nerfstudio,
)

OUTSIDE = "outside.png"
"""A picture beside the data set, of one colour that is in no photograph; it must never be read."""
PINK = (255, 0, 255)
SLOWEST = 10.0
"""Seconds; a loader that takes longer over a tiny data set hangs."""

SMALL = World(width=8, height=6)
SMALL_DTU = World(count=DTU_VIEWS, width=8, height=6)
BENT = World(width=8, height=6, distortion=(0.05, 0.01, 0.001, 0.0))


@dataclass(frozen=True)
class Format:
    """A data set to damage: loader, its settings, writer, and the files that are damaged."""

    loader: type[SceneLoader[Any]]
    write: Callable[[Path], Path]
    files: tuple[str, ...]
    settings: dict[str, Any]


_MODEL = ("cameras", "images", "points3D")
FORMATS = {
    "llff": Format(
        LLFFScene,
        lambda folder: write_llff(folder, SMALL),
        ("poses_bounds.npy", "points3d.npz"),
        {"downsample": 2},
    ),
    "blender": Format(
        BlenderScene,
        lambda folder: write_blender(folder, SMALL),
        ("transforms_train.json", "transforms_test.json"),
        {"train_ids": (1, 3, 5)},
    ),
    "nerfstudio": Format(
        NerfstudioScene, lambda folder: write_nerfstudio(folder, BENT), ("transforms.json",), {}
    ),
    "dtu": Format(
        DTUScene, lambda folder: write_dtu(folder, SMALL_DTU), ("cameras_sphere.npz",), {}
    ),
    "colmap binary": Format(
        ColmapScene,
        lambda folder: write_colmap(folder, BENT),
        tuple(f"sparse/0/{name}.bin" for name in _MODEL),
        {},
    ),
    "colmap text": Format(
        ColmapScene,
        lambda folder: write_colmap(folder, SMALL, text=True, model="PINHOLE"),
        tuple(f"sparse/0/{name}.txt" for name in _MODEL),
        {},
    ),
}

_NUMBERS = ("nan", "NaN", "inf", "-Infinity", "1e400", "-1", "0", "1e300", "9" * 25, "1e-300", "")
_NAMES = (
    f"../{OUTSIDE}",
    f"x/../../{OUTSIDE}",
    "/etc/hostname",
    "..",
    ".",
    "a\0b",
    "C:\\x",
    "é" * 300,
)
_DOUBLES = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300, 1e18)


def fuzz(name: str, folder: Path, count: int, seed: int = 0) -> int:
    """Load `count` damaged versions of a format's data set.

    Returns:
        How many of them were still a valid scene.

    Raises:
        AssertionError: a loader broke the rule; says for which file and seed.
    """
    target = FORMATS[name]
    scene_folder = target.write(folder / "scene")
    Image.new("RGB", (8, 6), PINK).save(folder / OUTSIDE)
    component = build(target.loader, path=scene_folder, **target.settings)
    whole = {file: (scene_folder / file).read_bytes() for file in target.files}
    expected = component.load()
    accepted = 0
    for number in range(seed, seed + count):
        randomness = random.Random(f"{name} {number}")
        file = randomness.choice(target.files)
        damaged = damage(whole[file], file, randomness)
        (scene_folder / file).write_bytes(damaged)
        try:
            accepted += _obeys(component, expected, f"{name}, file {file}, number {number}")
        finally:
            (scene_folder / file).write_bytes(whole[file])
    return accepted


def _obeys(component: SceneLoader[Any], expected: Scene, where: str) -> bool:
    """Whether the loader accepted the data set; it must have answered by the rule."""
    start = time.monotonic()
    try:
        scene = component.load()
    except ExplainedError:
        return False
    except BaseException as error:
        raise AssertionError(f"{where}: {type(error).__name__}: {error}") from error
    finally:
        assert time.monotonic() - start < SLOWEST, f"{where}: took too long"
    _check_accepted(scene, expected, where)
    return True


def _check_accepted(scene: Scene, expected: Scene, where: str) -> None:
    assert len(scene.train) <= len(expected.train), where
    assert 0 < scene.bounds[0] < scene.bounds[1] < float("inf"), where
    for view in (*scene.train, *scene.test):
        camera, image = view.camera, view.image
        pose = camera.world_to_camera.numpy()
        rotation = pose[:3, :3]
        assert np.isfinite(pose).all(), where
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-4, where
        assert np.linalg.det(rotation) > 0, where
        assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all(), where
        assert min(camera.fx, camera.fy) > 0, where
        assert image.shape == (camera.height, camera.width, 3), where
        assert not np.allclose(image.numpy(), np.array(PINK) / 255), where
        assert "/" not in view.name, where
        assert "\\" not in view.name, where
        assert view.name.isprintable(), where
    if scene.points is not None:
        assert np.isfinite(scene.points.positions.numpy()).all(), where


def damage(data: bytes, file: str, randomness: random.Random) -> bytes:
    """One to three mutations of a file; members of an archive are damaged within it."""
    if file.endswith(".npz") and randomness.random() < 0.8:
        return _damage_member(data, randomness)
    for _ in range(randomness.choice((1, 1, 1, 2, 3))):
        if file.endswith((".json", ".txt")) and randomness.random() < 0.7:
            data = _damage_text(data, randomness)
        else:
            data = _damage_bytes(data, randomness)
    return data


def _damage_member(data: bytes, randomness: random.Random) -> bytes:
    """Rewrite an archive so that its checksums fit and the damage gets as far as the numbers."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = randomness.choice(list(members))
    members[name] = _damage_bytes(members[name], randomness)
    if randomness.random() < 0.1:
        del members[randomness.choice(list(members))]
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return result.getvalue()


def _damage_text(data: bytes, randomness: random.Random) -> bytes:
    """Replace or swap numbers and names."""
    text = data.decode("utf-8", "surrogateescape")
    tokens = re.split(r"""([\s,:"\[\]{}]+)""", text)
    words = [k for k in range(0, len(tokens), 2) if tokens[k]]
    if not words:
        return data
    chosen = randomness.choice(words)
    kind = randomness.random()
    if kind < 0.4:
        tokens[chosen] = randomness.choice(_NUMBERS)
    elif kind < 0.6:
        named = [k for k in words if re.search(r"\.(png|JPG)$|/r_\d+$", tokens[k])] or words
        tokens[randomness.choice(named)] = randomness.choice(_NAMES)
    elif kind < 0.8:
        other = randomness.choice(words)
        tokens[chosen], tokens[other] = tokens[other], tokens[chosen]
    elif kind < 0.9:
        tokens[chosen] = ""
    else:
        tokens[chosen] = f"{tokens[chosen]}{randomness.choice(('0', '1', 'e9', '.', '-'))}"
    return "".join(tokens).encode("utf-8", "surrogateescape")


def _damage_bytes(data: bytes, randomness: random.Random) -> bytes:
    """Flip bits, cut, insert, repeat, swap, or write a remarkable number or name."""
    result = bytearray(data)
    if not result:
        return randomness.randbytes(8)
    place = randomness.randrange(len(result))
    length = randomness.choice((1, 4, 8, 64))
    kind = randomness.randrange(7)
    if kind == 0:
        for _ in range(randomness.choice((1, 2, 8))):
            result[randomness.randrange(len(result))] ^= 1 << randomness.randrange(8)
    elif kind == 1:
        del result[place:]
    elif kind == 2:
        del result[place : place + length]
    elif kind == 3:
        result[place:place] = randomness.randbytes(length)
    elif kind == 4:
        result[place : place + 8] = struct.pack("<d", randomness.choice(_DOUBLES))
    elif kind == 5:
        other = randomness.randrange(len(result))
        first, second = result[place : place + length], result[other : other + length]
        result[place : place + length], result[other : other + length] = second, first
    else:
        names = [match.span() for match in re.finditer(rb"IMG_\d+\.JPG", data)]
        if names:
            start, stop = randomness.choice(names)
            result[start:stop] = randomness.choice(_NAMES).encode()
        else:
            result[place : place + 8] = struct.pack("<Q", randomness.choice((0, 2**63, 2**31, 7)))
    return bytes(result)


def main(arguments: list[str]) -> None:
    """Fuzz all formats, or those named."""
    count = int(arguments[0])
    for name in arguments[1:] or FORMATS:
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            accepted = fuzz(name, Path(folder), count)
        seconds = time.monotonic() - start
        print(f"{name}: {count} files, {accepted} still valid scenes, {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
