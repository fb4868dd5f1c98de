"""Matches by the networks XFeat and LighterGlue, for photographs that SIFT does not match.

The files are read from the model folder if it has them, checked by hash (docs/prior_models.md), and never
downloaded. Their matches are added to those of SIFT, which are more exact.
"""

from __future__ import annotations

import os
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.toolkit.networks import KeypointNetworks, OnnxModel

from .unposed_photos import image_index, image_name

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from registry.toolkit.networks import Keypoints

FOLDER_VARIABLE = "STEREOGS_MODELS"
"""Environment variable with the path of the model folder."""
FINDER = (
    Path("xfeat", "xfeat_2048_640x360.onnx"),
    "78038a53f1f095a67ed1a0be424a5a5e7e64df4cc572e269df9de5d60c564fba",
)
MATCHER = (
    Path("xfeat", "lighterglue_L3.onnx"),
    "4b57f744da904cf3d7f6e8f4787c6f8a0165e7be7d83ff460a747b9ca826e6e7",
)
"""Paths relative to the folder, with SHA-256."""
FEWEST = 3
"""Least photographs of a piece: the networks match noise too, which fits two photographs but never three."""
MIN_SCORE = 0.1
"""Least score of a match; geometric verification removes the remaining wrong ones."""


def known_files() -> tuple[Path, Path] | None:
    """Paths of the two networks in the model folder, or None if one is missing."""
    root = os.environ.get(FOLDER_VARIABLE)
    if not root:
        return None
    finder, matcher = (Path(root, path) for path, _ in (FINDER, MATCHER))
    return (finder, matcher) if finder.is_file() and matcher.is_file() else None


def add_learned_matches(
    colmap: Any, files: tuple[Path, Path], images: Path, sift: Path, database: Path
) -> None:
    """Fill a database with unverified keypoints and matches of SIFT and the networks.

    Args:
        files: result of `known_files`.
        images: folder of the photographs, named by index.
        sift: database with the keypoints and matches of SIFT.
        database: database with the same photographs only.

    Raises:
        PluginError: a file does not match its hash, or cannot be run.
    """
    import numpy as np

    networks = KeypointNetworks(
        *(OnnxModel(file, sha) for file, (_, sha) in zip(files, (FINDER, MATCHER), strict=True))
    )
    with colmap.Database.open(sift) as known, colmap.Database.open(database) as opened:
        there = {image_index(image.name): image.image_id for image in known.read_all_images()}
        here = {image_index(image.name): image.image_id for image in opened.read_all_images()}
        found = {k: _keypoints(networks, images / image_name(k)) for k in sorted(here)}
        before = {k: known.read_keypoints(there[k])[:, :2] for k in found}
        for k, keypoints in found.items():
            opened.write_keypoints(here[k], _joined(before[k], keypoints.points.numpy()))
        for first, second in combinations(found, 2):
            pairs, _ = networks.match(found[first], found[second], MIN_SCORE)
            new = pairs.numpy() + np.array([len(before[first]), len(before[second])])
            old = known.read_matches(there[first], there[second])
            opened.write_matches(here[first], here[second], _joined(old, new))


def _keypoints(networks: KeypointNetworks, file: Path) -> Keypoints:
    import numpy as np
    import torch
    from PIL import Image

    with Image.open(file) as opened:
        image = torch.from_numpy(np.asarray(opened.convert("RGB"), np.float32) / 255)
    # Orientation per photograph: landscape and portrait match badly in any case.
    return networks.keypoints(image, turned=networks.turns(image))


def _joined(first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.generic]:
    import numpy as np

    return np.concatenate([first, second.astype(first.dtype)])
