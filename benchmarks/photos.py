"""Cameras estimated by `photos`, compared with published ones: `make bench-photos`.

Evenly spaced pictures of real data sets, and all pictures of each; the search uses nothing else. Finished
cases are kept in `benchmarks/out/photos`: the same command continues where it stopped. With `--write-docs`
rewrites the table in docs/your_own_photographs.md.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import pages
from registry.toolkit.photos import Decoder, evenly_spaced, longest_side
from registry.toolkit.photos import read_colmap_model as read_model
from stereogs_plugins.scenes.dtu.cameras import FULL_SIZE, calibrated
from stereogs_plugins.scenes.llff import read_poses
from stereogs_plugins.scenes.photos.structure_from_motion import Reconstruction, reconstruct
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, image_index, read_folder

PAGE = pages.DOCS / "your_own_photographs.md"
OUT = Path(__file__).parent / "out" / "photos"
SCENES = ("llff_fern", "llff_flower", "dtu_scan65", "mip360_bonsai")
CASES = (
    *((scene, count) for count in (3, 6, 12) for scene in SCENES),
    *((scene, None) for scene in SCENES),
)
"""Data set and number of its pictures, None for all."""
_MARKS = ("<!-- cameras: begin -->", "<!-- cameras: end -->")
_MATCHING_SIZE = 1200
_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Published:
    """A published camera.

    Args:
        rotation: `[3, 3]`, world to camera.
        focal: Focal length in units of the picture's longer side.
    """

    rotation: _Array
    focal: float


@dataclass(frozen=True)
class Record:
    """Result of one case.

    Args:
        placed: Number of pictures whose cameras fit together.
        rotation_median, rotation_largest: Errors in degrees after the best common rotation; None if no camera
            was placed.
        focal_error: Relative error of the focal length; None if no camera was placed.
        cpu_seconds: CPU seconds of the search over all threads, without reading the folder.
    """

    scene: str
    pictures: int
    placed: int
    rotation_median: float | None
    rotation_largest: float | None
    focal_error: float | None
    cpu_seconds: float


def measure(scene: str, count: int | None) -> Record:
    """Estimate the cameras of `count` evenly spaced pictures of a scene, or of all."""
    photos, published = _pictures(scene, count)
    start = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        decoder = Decoder(longest_side(_MATCHING_SIZE), "box", upright=True)
        found = reconstruct(photos, decoder, True, Path(name))
        seconds = time.process_time() - start
        placed = len(found.pieces[0].members) if found.pieces else 0
        median, largest, focal = (
            _errors(found, photos, published) if found.pieces else (None, None, None)
        )
    return Record(scene, len(photos), placed, median, largest, focal, seconds)


def _pictures(scene: str, count: int | None) -> tuple[list[UnposedPhoto], dict[str, Published]]:
    folder = Path(os.environ["STEREOGS_DATA"], scene)
    published = dict(_dtu(folder) if scene.startswith("dtu") else _llff(folder))
    images = next(path for path in sorted(folder.glob("image*")) if path.is_dir())
    photos = [photo for photo in read_folder(images).photos if photo.path.stem in published]
    return [photos[k] for k in evenly_spaced(list(range(len(photos))), count)], published


def _llff(folder: Path) -> Iterator[tuple[str, Published]]:
    rows = read_poses(folder / "poses_bounds.npy")
    listed = folder / "split.json"
    if listed.is_file():
        names = [Path(name).stem for name in json.loads(listed.read_text())["all_names"]]
    else:
        names = [path.stem for path in sorted((folder / "images_8").iterdir())]
    for name, row in zip(names, rows, strict=True):
        focal = row.lens.fx / max(row.lens.width, row.lens.height)
        yield name, Published(row.world_to_camera[:3, :3], focal)


def _dtu(folder: Path) -> Iterator[tuple[str, Published]]:
    numbers = {int(path.stem): path.stem for path in (folder / "image").iterdir()}
    for number, camera in calibrated(folder / "cameras_sphere.npz", list(numbers)).cameras.items():
        focal = camera.lens.fx / max(FULL_SIZE)
        yield numbers[number], Published(camera.world_to_camera[:3, :3], focal)


def _errors(
    found: Reconstruction, photos: list[UnposedPhoto], published: dict[str, Published]
) -> tuple[float, float, float]:
    """Median and largest rotation error in degrees, and the relative error of the focal length."""
    model = read_model(found.pieces[0].folder, "")
    truth = [published[photos[image_index(image.name)].path.stem] for _, image in model.images]
    rotations = [image.world_to_camera[:3, :3] for _, image in model.images]
    # The best rotation between the two worlds (orthogonal Procrustes).
    u, _, v = np.linalg.svd(sum(t.rotation.T @ r for t, r in zip(truth, rotations, strict=True)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    cosines = [
        (np.trace(t.rotation @ turn @ r.T) - 1) / 2 for t, r in zip(truth, rotations, strict=True)
    ]
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    lens = model.lens(model.images[0][1])
    focal = lens.fx / max(lens.width, lens.height)
    return float(np.median(angles)), float(angles.max()), focal / truth[0].focal - 1


def table(records: list[Record]) -> str:
    """Return the records as a table."""
    rows = []
    for record in records:
        cells = ["-", "-", "-"]
        if record.focal_error is not None:
            angles = (record.rotation_median, record.rotation_largest)
            cells = [*(f"{angle:.2f}°" for angle in angles), f"{100 * record.focal_error:+.1f} %"]
        row = [record.scene, record.pictures, record.placed, *cells, f"{record.cpu_seconds:.0f}"]
        rows.append([str(cell) for cell in row])
    headings = ["pictures of", "given", "placed", "rotation, median", "largest", "focal length"]
    return pages.table([*headings, "CPU s"], rows, left=7)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help=f"also write docs/{PAGE.name}")
    arguments = parser.parse_args()
    if "STEREOGS_DATA" not in os.environ:
        raise SystemExit(f"set STEREOGS_DATA to the folder that holds {', '.join(SCENES)}")
    OUT.mkdir(parents=True, exist_ok=True)
    for number, (scene, count) in enumerate(CASES, start=1):
        print(f"{number} of {len(CASES)}: {count or 'all'} of {scene}", flush=True)
        file = OUT / f"{scene}_{count or 'all'}.json"
        if not file.is_file():
            record = json.dumps(asdict(measure(scene, count)))
            file.write_text(record, "utf-8")
    order = {scene: number for number, scene in enumerate(SCENES)}
    records = [Record(**json.loads(file.read_text())) for file in OUT.glob("*.json")]
    records.sort(key=lambda record: (order[record.scene], record.pictures))
    print(table(records))
    if arguments.write_docs:
        pages.rewrite(PAGE, _MARKS, table(records))


if __name__ == "__main__":
    main()
