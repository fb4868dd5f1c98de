"""Cameras estimated by `photos`, compared with published ones: `make bench-photos`.

Evenly spaced and neighbouring pictures of every data set, without and with networks (`STEREOGS_MODELS`). The
search uses nothing else. One of the placed pictures is held out from a training with the found cameras, and
from one with the published ones. Cases that are in `benchmarks/records/photos.jsonl` are not measured again.
With `--write-docs` rewrites the tables.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks import pages
from benchmarks.photos_published import SCENES, Published, pictures
from benchmarks.photos_scored import psnr_of_both
from benchmarks.records import RECORDS, append, lines
from registry.toolkit.networks import MODELS_VARIABLE
from registry.toolkit.photos import (
    ColmapModel,
    Decoder,
    evenly_spaced,
    longest_side,
    read_colmap_model,
)
from stereogs.experiments.showing.score_table import markdown
from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_index
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import reconstruct
from stereogs_plugins.scenes.photos.photogrammetry.thresholds import MIN_PHOTOS
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto

FILE = RECORDS / "photos.jsonl"
SETS = ("near 3", "3", "4", "near 6", "6", "8", "12")
"""Neighbouring pictures from the first third on, or evenly spaced ones; cheapest first."""
_MATCHING_SIZE = 1200


@dataclass(frozen=True)
class Errors:
    """Errors of estimated cameras after the similarity that aligns them with the published ones.

    Args:
        rotation: Median and largest, degrees.
        position: Root mean square in units of that of the distances to the cameras' mean.
        focal: Relative error of the focal length.
    """

    rotation: tuple[float, float]
    position: float
    focal: float


@dataclass(frozen=True)
class CameraRecord:
    """Result of one case.

    Args:
        pictures: Number of pictures.
        placed: Number of pictures whose cameras fit together.
        errors: None if fewer than `MIN_PHOTOS` were placed.
        cpu_seconds: CPU seconds of the search over all threads, without reading the folder.
        psnr: with estimated and with published cameras (`photos_scored`); None without errors, or if only the
            cameras were measured.
    """

    scene: str
    chosen: str
    networks: bool
    pictures: int
    placed: int
    errors: Errors | None
    cpu_seconds: float
    psnr: tuple[float, float] | None

    @property
    def case(self) -> tuple[str, str, bool]:
        return self.scene, self.chosen, self.networks


def cases() -> Iterator[tuple[str, str, bool]]:
    """Scene, set, and whether networks may be used; small sets of all scenes first."""
    for chosen in SETS:
        for scene in SCENES:
            yield scene, chosen, False
            yield scene, chosen, True


def measure(scene: str, chosen: str, networks: bool) -> CameraRecord | None:
    """Estimate the cameras of a set of pictures; None if the scene has too few."""
    photos, published = pictures(scene)
    count = int(chosen.split()[-1])
    first = len(photos) // 3 if chosen.startswith("near") else 0
    if first + count > len(photos):
        return None
    rows = range(first, first + count) if first else evenly_spaced(list(range(len(photos))), count)
    photos = [photos[k] for k in rows]
    models = os.environ[MODELS_VARIABLE] if networks else ""
    start = time.process_time()
    with tempfile.TemporaryDirectory() as name, patch.dict(os.environ, {MODELS_VARIABLE: models}):
        decoder = Decoder(longest_side(_MATCHING_SIZE), "box", upright=True)
        found = reconstruct(photos, decoder, True, Path(name))
        seconds = round(time.process_time() - start, 1)
        placed = len(found.pieces[0].members) if found.pieces else 0
        errors = psnr = None
        if placed >= MIN_PHOTOS:
            model = read_colmap_model(found.pieces[0].folder, "")
            errors = _errors(model, photos, published)
            true = [published[photo.path.stem] for photo in photos]
            psnr = psnr_of_both(model, photos, true)
    return CameraRecord(scene, chosen, networks, count, placed, errors, seconds, psnr)


def _errors(
    model: ColmapModel, photos: list[UnposedPhoto], published: dict[str, Published]
) -> Errors:
    truth = [published[photos[image_index(image.name)].path.stem] for _, image in model.images]
    poses = np.array([image.world_to_camera for _, image in model.images])
    true = np.array([one.pose for one in truth])
    # The best rotation between the two worlds (orthogonal Procrustes).
    u, _, v = np.linalg.svd(np.einsum("kji,kjl->il", true[:, :3, :3], poses[:, :3, :3]))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    cosines = (np.einsum("kij,jl,kil->k", true[:, :3, :3], turn, poses[:, :3, :3]) - 1) / 2
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    lens = model.lens(model.images[0][1])
    focal = lens.fx / max(lens.width, lens.height) / truth[0].focal - 1
    places, moved = _centers(true), _centers(poses) @ turn.T
    scale = (places * moved).sum() / (moved**2).sum()
    position = np.linalg.norm(places - scale * moved) / np.linalg.norm(places)
    rotation = (round(float(np.median(angles)), 2), round(float(angles.max()), 2))
    return Errors(rotation, round(float(position), 4), round(float(focal), 4))


def _centers(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Camera centres `[N, 3]` relative to their mean."""
    centers = -np.einsum("kji,kj->ki", poses[:, :3, :3], poses[:, :3, 3])
    result: NDArray[np.float64] = centers - centers.mean(axis=0)
    return result


def read_records() -> dict[tuple[str, str, bool], CameraRecord]:
    """Return the records by case."""
    found = {}
    for values in lines(FILE):
        errors = values.pop("errors")
        record = CameraRecord(**values, errors=Errors(**errors) if errors else None)
        found[record.case] = record
    return found


def table(records: Iterable[CameraRecord]) -> str:
    """Return every record with all of its errors."""
    rows = []
    for record in records:
        cells, psnr = ["-", "-", "-", "-"], ["", ""]
        if record.errors is not None:
            median, largest = record.errors.rotation
            cells = [f"{median:.2f}°", f"{largest:.2f}°", f"{100 * record.errors.position:.1f} %"]
            cells.append(f"{100 * record.errors.focal:+.1f} %")
        if record.psnr is not None:
            psnr = [f"{value:.1f}" for value in record.psnr]
        kind = "with networks" if record.networks else "SIFT"
        placed = f"{record.placed} of {record.pictures}"
        rows.append(
            [record.scene, record.chosen, kind, placed, *cells, f"{record.cpu_seconds:.0f}", *psnr]
        )
    headings = ["pictures of", "set", "matches", "placed", "rotation, median", "largest"]
    headings += ["position", "focal length", "CPU s", "PSNR", "with published cameras"]
    return markdown(headings, rows, names=3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help="also write the tables")
    parser.add_argument("--finished", action="store_true", help="use only records that exist")
    arguments = parser.parse_args()
    for variable in ("STEREOGS_DATA", MODELS_VARIABLE):
        if not os.environ.get(variable):
            raise SystemExit(f"set {variable} (docs/your_own_photographs.md)")
    records = read_records()
    for case in () if arguments.finished else cases():
        if case in records:
            continue
        scene, chosen, networks = case
        plain = records.get((scene, chosen, False))
        if networks and plain is not None and plain.placed == plain.pictures:
            record: CameraRecord | None = replace(plain, networks=True)  # they are not asked
        else:
            print(*case, flush=True)
            record = measure(*case)
        if record is not None:
            records[case] = record
            append(asdict(record), FILE)
    listed = sorted(records.values(), key=lambda r: (SCENES.index(r.scene), SETS.index(r.chosen)))
    print(table(listed))
    if arguments.write_docs:
        pages.write_tables("photos", "Cameras of few pictures", "bench-photos", table(listed))


if __name__ == "__main__":
    main()
