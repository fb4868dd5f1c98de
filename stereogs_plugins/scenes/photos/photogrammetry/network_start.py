"""Cameras of a prior (`PosedDepthPrior`) as a start: matches triangulate points with them and refine them.

Networks answer confidently for unrelated photographs too. So nothing of an answer is kept but the scale: the
cameras are adjusted to the matches, first with wide tolerances, and support.py decides as for other models.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import thresholds
from .colmap import (
    bundle_adjust,
    image_name,
    index_of,
    lens_of,
    model_from_cameras,
    scale,
    triangulated,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from torch import Tensor

    from registry.priors import PosedDepth

    from .colmap import Model

    Estimate = Callable[[Sequence[Tensor], Sequence[Tensor | None]], list[PosedDepth]]
    """As `PosedDepthPrior.posed_depths`."""


def estimated(estimate: Estimate, images: Path, focals: Sequence[float | None]) -> list[PosedDepth]:
    """Return the prior's answer for the photographs in a folder, named by index.

    Args:
        focals: focal length by EXIF of each photograph, in units of the longer side.
    """
    import torch
    from PIL import Image

    pictures, lenses = [], []
    for k, focal in enumerate(focals):
        with Image.open(images / image_name(k)) as opened:
            pixels = torch.from_numpy(np.array(opened.convert("RGB"), np.float32) / 255)
        height, width = pixels.shape[:2]
        lens = None
        if focal is not None:
            f = focal * max(width, height)
            lens = torch.tensor(
                [[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], dtype=torch.float64
            )
        pictures.append(pixels)
        lenses.append(lens)
    return estimate(pictures, lenses)


def refined_start(
    answers: Sequence[PosedDepth], database: Path, images: Path, folder: Path, fixed_lens: bool
) -> list[Model]:
    """Return the model that matches make of the cameras of an answer; none without points.

    Args:
        answers: of each photograph, by index.
        database: keypoints, matches and two-view geometries.
        folder: for files that COLMAP writes.
        fixed_lens: keep the focal lengths of EXIF, or of the answer.
    """
    poses = [answer.world_to_camera[:3].numpy() for answer in answers]
    focals = [float(answer.intrinsics.diagonal()[:2].mean()) for answer in answers]
    model = model_from_cameras(database, poses, focals)
    for degrees, share in thresholds.START_ROUNDS:
        side = max(max(lens.width, lens.height) for lens in model.cameras.values())
        pixels = max(share * side, thresholds.MAX_ERROR)
        model = triangulated(model, database, images, folder, degrees=degrees, pixels=pixels)
        if not model.num_points3D():
            return []
        bundle_adjust(model, fixed_lens, None)
    return [scaled_to_depth(model, answers)]


def scaled_to_depth(model: Model, answers: Sequence[PosedDepth]) -> Model:
    """Return the model in the unit of the answers' depth, by the median over the points."""
    ratios = []
    for k in sorted(model.reg_image_ids()):
        image, lens = model.image(k), lens_of(model, k)
        depth = answers[index_of(model, k)].depth.numpy()
        for seen in image.points2D:
            column, row = (int(x) for x in seen.xy)
            if seen.has_point3D() and 0 <= column < lens.width and 0 <= row < lens.height:
                z = (image.cam_from_world() * model.point3D(seen.point3D_id).xyz)[2]
                ratios.append(depth[row, column] / z)
    known = [ratio for ratio in ratios if ratio > 0]
    return scale(model, float(np.median(known))) if known else model
