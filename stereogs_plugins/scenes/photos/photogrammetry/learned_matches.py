"""Matches by the networks ALIKED and LightGlue, for photographs that SIFT does not match.

ALIKED (Zhao et al. 2023) finds keypoints, LightGlue (Lindenberger et al., ICCV 2023) matches them. The files
are read from the model folder if it has them (`stereogs models`), checked by hash, and never downloaded.
Their matches are added to those of SIFT, which are more exact.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from registry.toolkit.networks import KeypointNetworks, Keypoints, OnnxModel, model_files
from registry.toolkit.progress import tracked

from . import thresholds
from .colmap import image_index, image_name, mask_of, open_database, verified_pairs, verify_matches

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

Scalar = TypeVar("Scalar", np.float32, np.uint32)
FOLDER = "aliked_lightglue"
KNOWN = (
    {
        "finder.onnx": "b7d721d95f3395a72640a4a302d42638fa446f0df362b37640fc083912160cbe",
        "matcher.onnx": "9c005c10345743c7ae1cea7d0ec43ee106584705437ead2dbcca44759251f409",
    },
    {
        "aliked_n16.onnx": "84d88b0cfc2c440e1ef9f817e540f048758bb3b135e5e22ff41053309e283da7",
        "lightglue_aliked.onnx": "39daccc933227e48a3cf92f76a478b9b57bf2872e396a9799524b9d1c5f32f7c",
    },
)
"""ALIKED and LightGlue with their SHA-256, in a folder of the model folder: what `stereogs models get
aliked-lightglue` writes, then an earlier conversion of the same weights."""


def known_files() -> tuple[Path, ...] | None:
    """Paths of the first complete pair of networks in the folder STEREOGS_MODELS, or None."""
    found = (model_files(*(Path(FOLDER, name) for name in names)) for names in KNOWN)
    return next((files for files in found if files), None)


def add_learned_matches(
    files: tuple[Path, ...], images: Path, sift: Path, database: Path, connected: Collection[int]
) -> None:
    """Fill a database with keypoints and verified matches of SIFT and the networks.

    The photographs that SIFT connects are matched with the others first, and with each other only if that
    has any success: one photograph of another place does not cost the matching of all pairs.

    Args:
        files: result of `known_files`.
        images: folder of the upright photographs, named by index.
        sift: database with the keypoints and matches of SIFT.
        database: database with the same photographs only.
        connected: indices of photographs that SIFT connects.

    Raises:
        PluginError: a file does not match its hash, or cannot be run.
    """
    hashes = {name: sha256 for names in KNOWN for name, sha256 in names.items()}
    networks = KeypointNetworks(
        *(OnnxModel(file, hashes[file.name]) for file in files),
        multiple=1,
    )
    with open_database(sift) as known, open_database(database) as opened:
        there = {image_index(image.name): image.image_id for image in known.read_all_images()}
        here = {image_index(image.name): image.image_id for image in opened.read_all_images()}
        found = {
            k: _keypoints(networks, images / image_name(k))
            for k in tracked(sorted(here), "keypoints")
        }
        before = {k: known.read_keypoints(there[k])[:, :2] for k in found}
        for k, keypoints in found.items():
            opened.write_keypoints(here[k], _joined(before[k], keypoints.points.numpy()))
        pairs = list(combinations(found, 2))
        known_well = [pair for pair in pairs if {*pair} <= {*connected}]
        for part in ([pair for pair in pairs if pair not in known_well], known_well):
            for first, second in tracked(part, "matching"):
                rows, _ = networks.match(found[first], found[second], thresholds.MIN_SCORE)
                new = rows.numpy() + np.array([len(before[first]), len(before[second])])
                old = known.read_matches(there[first], there[second])
                opened.write_matches(here[first], here[second], _joined(old, new))
            verify_matches(database)
            most = max((len(pair.matches) for pair in verified_pairs(opened)), default=0)
            if most < thresholds.MIN_CHECKED or not known_well:
                break


def _keypoints(networks: KeypointNetworks, file: Path) -> Keypoints:
    """The best keypoints of a picture, which is scaled to `KEYPOINT_SIZE` first; none where it is masked."""
    import torch
    from PIL import Image

    with Image.open(file) as opened:
        picture = opened.convert("RGB")
    scale = min(thresholds.KEYPOINT_SIZE / max(picture.size), thresholds.MAX_ENLARGED)
    width, height = (round(side * scale) for side in picture.size)
    scaled = picture.resize((width, height), Image.Resampling.BICUBIC)
    image = torch.from_numpy(np.asarray(scaled, np.float32) / 255)
    found = networks.keypoints(image, turned=False)
    points = found.points * torch.tensor([picture.width / width, picture.height / height])
    kept = torch.arange(len(points))
    if mask_of(file).is_file():
        with Image.open(mask_of(file)) as opened:
            counts = torch.from_numpy(np.asarray(opened) > 0)
        columns, rows = points.long().T
        last = torch.tensor(counts.shape) - 1
        kept = kept[counts[rows.clamp(0, last[0]), columns.clamp(0, last[1])]]
    kept = kept[: thresholds.MAX_KEYPOINTS]
    return Keypoints(points[kept], found.normalized[:, kept], found.descriptors[:, kept])


def _joined(first: NDArray[Scalar], second: NDArray[Any]) -> NDArray[Scalar]:
    return np.concatenate([first, second.astype(first.dtype)])
