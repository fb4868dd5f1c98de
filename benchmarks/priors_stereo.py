"""Stereo priors against ground truth, for `benchmarks.priors`.

Reads the pairs `stereo_NAME` (left.png, right.png, disp.npz) in the folder that STEREOGS_DATA names.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from core_rasterizer import Device
from registry import Context
from registry.priors import Disparity
from stereogs_plugins.priors.sgm import SgmPrior, SgmSettings

NAMES = ("cones", "tsukuba", "motorcycle", "playground")
REPEATS = 3


@dataclass(frozen=True, eq=False)
class Pair:
    """A rectified pair with known disparity.

    Args:
        left, right: `[H, W, 3]` float32 in [0, 1].
        disparity: `[H, W]` float32, the left image's, pixels.
        known: `[H, W]` bool: the disparity is known and, where the data set says so, not occluded.
    """

    left: Tensor
    right: Tensor
    disparity: Tensor
    known: Tensor

    @property
    def largest(self) -> int:
        """A bound on the disparity, with a margin of 10 %, as a user would set it."""
        return int(1.1 * float(self.disparity[self.known].max())) + 1


@dataclass(frozen=True)
class Score:
    """Errors over the pixels of known disparity; a pixel without an answer counts as disparity 0.

    Args:
        error: mean absolute error, pixels.
        bad_1, bad_2: per cent of pixels that are off by more than 1 and 2 pixels.
    """

    error: float
    bad_1: float
    bad_2: float


def load_pair(folder: Path) -> Pair:
    """Read `left.png`, `right.png` and `disp.npz` (`disp`, NaN = unknown; `nonocc` if known)."""
    left, right = (_image(folder / f"{side}.png") for side in ("left", "right"))
    with np.load(folder / "disp.npz") as arrays:
        disparity = torch.from_numpy(arrays["disp"].astype(np.float32))
        known = torch.isfinite(disparity)
        if "nonocc" in arrays:
            known &= torch.from_numpy(arrays["nonocc"])
    return Pair(left, right, disparity, known)


def score(answer: Disparity, pair: Pair) -> Score:
    """Compare an answer with the truth."""
    errors = (answer.values - pair.disparity)[pair.known].abs()
    bad_1, bad_2 = (100 * float((errors > limit).float().mean()) for limit in (1, 2))
    return Score(float(errors.mean()), bad_1, bad_2)


def measure(device: Device, features: Path | None = None) -> list[dict[str, Any]]:
    """Measure errors and times of each variant on each pair found.

    Args:
        features: ONNX file for the cost `features`; None skips that variant.

    Returns:
        Rows with the keys `variant`, `pair`, `error` (pixels), `bad_1`, `bad_2` (per cent) and
        `seconds` (median of some runs of the left image's disparity).
    """
    variants: dict[str, dict[str, Any]] = {"census": {}, "zncc": {"cost": "zncc"}}
    if features is not None:
        variants["features"] = {"cost": "features", "features": features}
    root = Path(os.environ.get("STEREOGS_DATA", "."))
    folders = {name: root / f"stereo_{name}" for name in NAMES}
    rows = []
    for name, folder in folders.items():
        if not folder.is_dir():
            continue
        pair = load_pair(folder)
        for variant, chosen in variants.items():
            settings = SgmSettings(max_disparity=pair.largest, **chosen)
            prior = SgmPrior(settings, Context("sgm", 0, device))
            answer = prior.disparity(pair.left, pair.right)
            found = score(answer, pair)
            row = {"variant": variant, "pair": name, **vars(found)}
            rows.append({**row, "seconds": median(_seconds(prior, pair) for _ in range(REPEATS))})
    return rows


def _seconds(prior: SgmPrior, pair: Pair) -> float:
    begin = time.perf_counter()
    prior.disparity(pair.left, pair.right)
    return time.perf_counter() - begin


def _image(path: Path) -> Tensor:
    with Image.open(path) as image:
        return torch.from_numpy(np.asarray(image.convert("RGB"), dtype=np.float32) / 255)


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the rows of `measure` as cells, after a header."""
    lines = [["pair", "`sgm` with", "error, px", "> 1 px, %", "> 2 px, %", "seconds"]]
    for row in rows:
        numbers = (f"{row[key]:.2f}" for key in ("error", "bad_1", "bad_2", "seconds"))
        lines.append([row["pair"], row["variant"], *numbers])
    return lines
