"""Compare a folder with a published data set."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, TypeAdapter

from registry import RunError, SceneError
from registry.messages.suggestions import did_you_mean, listing
from registry.pipeline.protocols import load_protocol
from registry.pipeline.settings_check import plain
from registry.pipeline.yaml_source import read
from registry.toolkit.photos import list_images, read_array, read_arrays, stored_size

_FILE = Path(__file__).with_name("known.yaml")
_DTU_VIEWS = 49
"""Photographs of a scan in the protocol; some copies have 64 cameras."""
CONSEQUENCES = {
    "cameras": "every score changes: compare with no published number",
    "sphere": "the unit and the first points change, and with them the scores",
    "names": "the split follows the sorted names: other photographs may train and test",
    "size": "another program made the photographs smaller: on LLFF that alone changed half a decibel",
    "photographs": "the scores are of other pixels: compare only with runs on this copy",
}
"""What a difference in a part does to scores."""


class DataSet(BaseModel):
    """An entry of known.yaml.

    Args:
        name: for people.
        protocols: names of the protocols on it.
        published: where its files are.
        cameras: their files.
        photographs: folder of the photographs.
        masks: their folder, if metrics need it.
        size: width and height of the photographs as published, in pixels.
        shared: digests by part that hold for all scenes.
        scenes: digests by part for each scene.
    """

    model_config = ConfigDict(extra="forbid")

    name: str
    protocols: tuple[str, ...]
    published: str
    cameras: tuple[str, ...]
    photographs: str
    masks: str | None = None
    size: tuple[int, int] | None = None
    shared: dict[str, str] = {}
    scenes: dict[str, dict[str, str]] = {}

    @property
    def files(self) -> tuple[str, ...]:
        """What a scene's folder must have."""
        return (*self.cameras, f"{self.photographs}/", *([f"{self.masks}/"] if self.masks else []))

    def known(self, scene: str) -> dict[str, str]:
        """Return the digests of a scene by part."""
        return {**self.shared, **self.scenes.get(scene, {})}


class Finding(NamedTuple):
    """A part of a data set: "as published", "not verified", or how it differs and what that does."""

    part: str
    state: str
    consequence: str = ""


@cache
def data_sets() -> tuple[DataSet, ...]:
    """Return the published data sets."""
    return TypeAdapter(tuple[DataSet, ...]).validate_python(plain(read(_FILE)))


def data_set_of(protocol: str) -> DataSet:
    """Return the data set of a protocol.

    Raises:
        RunError: the protocol is unknown, or of another package.
    """
    names = {name: data_set for data_set in data_sets() for name in data_set.protocols}
    if protocol not in names:
        raise RunError(
            f"nothing is known about the data of {protocol!r}{did_you_mean(protocol, names)}",
            where="the command line",
            fix=f"protocols: {listing(names)}",
        )
    return names[protocol]


def scene_of(protocol: str, folder: Path) -> str:
    """Return the name of a folder's scene: the folder's name or its end, "fern" for `llff_fern`.

    Raises:
        RunError: the protocol has no such scene.
    """
    known = dict.fromkeys([*load_protocol(protocol).scenes, *data_set_of(protocol).scenes])
    name = folder.resolve().name
    for scene in known:
        if name == scene or name.endswith(f"_{scene}"):
            return scene
    raise RunError(
        f"{name!r} does not end in the name of a scene of {protocol}",
        where=str(folder),
        fix=f"name the folder like one of {listing(known)}",
    )


def verify(protocol: str, folder: Path) -> Iterator[Finding]:
    """Yield what is missing, and how each part compares with what was published."""
    data_set, scene = data_set_of(protocol), scene_of(protocol, folder)
    known, present = data_set.known(scene), True
    for file in data_set.files:
        path = folder / file
        if not (list_images(path) if file.endswith("/") else path.is_file()):
            present = False
            yield Finding(file, "missing", f"it is published in {data_set.published}")
    if not present:
        return
    if data_set.size is not None:
        first = list_images(folder / data_set.photographs)[0]
        found, wanted = ("x".join(map(str, size)) for size in (stored_size(first), data_set.size))
        state = "as published" if found == wanted else f"{found} pixels instead of {wanted}"
        yield _finding("size", state)
    for part, digest in _PARTS.items():
        if part in known:
            same = digest(data_set, folder) == known[part]
            yield _finding(part, "as published" if same else "differs")
    if missing := [part for part in ("cameras", "names", "photographs") if part not in known]:
        yield Finding(
            ", ".join(missing), f"not verified: no digest is known for {data_set.name} {scene}"
        )


def _finding(part: str, state: str) -> Finding:
    return Finding(part, state, "" if state == "as published" else CONSEQUENCES[part])


def _sha256(*parts: bytes) -> str:
    hasher = hashlib.sha256()
    for part in parts:
        hasher.update(part)
    return hasher.hexdigest()


def _values(array: ArrayLike, kind: str) -> bytes:
    return np.ascontiguousarray(array, kind).tobytes()


def _cameras(data_set: DataSet, folder: Path) -> str:
    """Digest numbers, not files: 64-bit of LLFF and Blender, 32-bit of DTU, as published."""
    file, fix = data_set.cameras[0], f"restore it from {data_set.published}"
    if file.endswith(".npy"):
        return _sha256(_values(read_array(folder / file, "the camera file", fix), "<f8"))
    if file.endswith(".npz"):
        return _sha256(_matrices(folder / file, "world", fix))
    return _sha256(*(part for name in data_set.cameras for part in _frames(folder / name, fix)))


def _sphere(data_set: DataSet, folder: Path) -> str:
    return _sha256(_matrices(folder / data_set.cameras[0], "scale", "restore it"))


def _matrices(file: Path, kind: str, fix: str) -> bytes:
    names = [f"{kind}_mat_{index}" for index in range(_DTU_VIEWS)]
    arrays = read_arrays(file, names, "the camera file", fix)
    return b"".join(_values(arrays[name], "<f4") for name in names)


def _frames(file: Path, fix: str) -> Iterator[bytes]:
    """Yield the angle, then each camera by number, of the test views every eighth, which protocols use."""
    try:
        content = json.loads(file.read_text("utf-8"))
        numbers = {int(re.findall(r"\d+", f["file_path"])[-1]): f for f in content["frames"]}
        every = 8 if "test" in file.stem else 1
        yield _values(content["camera_angle_x"], "<f8")
        for number in sorted(numbers):
            if number % every == 0:
                yield f"{number}:".encode() + _values(numbers[number]["transform_matrix"], "<f8")
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise SceneError(f"{file.name} is damaged: {error}", where=str(file), fix=fix) from error


def _names(data_set: DataSet, folder: Path) -> str:
    names = sorted(path.stem for path in list_images(folder / data_set.photographs))
    return _sha256("\n".join(names).encode())


def _photographs(data_set: DataSet, folder: Path) -> str:
    files = sorted(list_images(folder / data_set.photographs))
    return _sha256(*(hashlib.sha256(file.read_bytes()).digest() for file in files))


_PARTS: dict[str, Callable[[DataSet, Path], str]] = {
    "cameras": _cameras,
    "sphere": _sphere,
    "names": _names,
    "photographs": _photographs,
}
