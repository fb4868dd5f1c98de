"""The one check that every scene loader ends in."""

from __future__ import annotations

import logging
import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from ...errors import SceneError
from ..fact import Fact
from ..scene import PointCloud, Scene, View

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

_FACT_NAME = re.compile(r"[A-Za-z0-9_-]+")
_ROTATION_TOLERANCE = 1e-4
_FARTHEST = 1e9
"""World units; beyond, squares and products of positions leave single precision."""
_FEWEST_BESIDE_COPIES = 3
"""Training views that a scene must have beside those that are left out."""
_log = logging.getLogger("stereogs.scene")
_FOCAL_RANGE = (1e-2, 1e4)
"""In units of the longer side of the image: from 179 degrees of view to 20 seconds of arc."""


def validate(scene: Scene) -> Scene:
    """Refuse a scene that training could not use; return it otherwise.

    Of training views with one pose the first stays, if at least three views do; a warning and a fact
    name the others.

    Raises:
        SceneError: no training view; a repeated or unsafe name; two of few views from one pose; a
            rotation that is none (to 1e-4), a focal length or position beyond belief; an image whose
            size is not the camera's, whose values are not finite or not in [0, 1]; a mask that is not
            bool, does not fit or leaves no pixel; an alpha that does not fit or is not in [0, 1]; a
            depth that does not fit or is not finite; points
            that are not finite or have colours outside [0, 1]; bounds out of order; two facts of one
            name, or a fact that JSON cannot say.
    """
    if not scene.train:
        raise SceneError(
            "the scene has no training view", where=scene.name, fix="check the folder and the split"
        )
    seen: set[str] = set()
    for view in (*scene.train, *scene.test):
        _validate_view(view, scene.name)
        if view.name in seen:
            raise SceneError(
                f"two views are named {view.name!r}", where=scene.name, fix="rename one of them"
            )
        seen.add(view.name)
    scene = _without_equal_poses(scene)
    near, far = scene.bounds
    if not 0 < near < far < float("inf"):
        raise SceneError(
            f"the depth bounds are ({near:g}, {far:g}); they must satisfy 0 < near < far",
            where=scene.name,
            fix="correct them in the file or the code that they come from",
        )
    if scene.points is not None:
        check_points(scene.points, scene.name)
        colors = scene.points.colors
        if len(colors) and not 0 <= colors.min() <= colors.max() <= 1:
            raise SceneError(
                "the points have colours outside [0, 1]",
                where=scene.name,
                fix="divide 8-bit values by 255",
            )
    _validate_facts(scene)
    return scene


def _validate_view(view: View, scene_name: str) -> None:
    where = f"{scene_name}, view {view.name!r}"
    if not is_file_name(view.name):
        raise SceneError(
            "a view's name must be a plain file name",
            where=where,
            fix="at most 200 printable characters, no slashes, not dots alone",
        )
    _validate_camera(view.camera, where)
    camera, image = view.camera, view.image
    if image.shape != (camera.height, camera.width, 3):
        raise SceneError(
            f"the image has shape {tuple(image.shape)} but its camera is "
            f"{camera.width}x{camera.height}",
            where=where,
            fix="use images of one size, the size that the poses were made for",
        )
    low, high = image.aminmax()  # one pass; a NaN becomes both and compares as false
    if not 0 <= low <= high <= 1:
        raise SceneError(
            "the image has values outside [0, 1] or not finite",
            where=where,
            fix="divide 8-bit values by 255, and leave damaged pixels to the mask",
        )
    _validate_maps(view, where)


def is_file_name(name: str) -> bool:
    """Whether a name can be a file's, with an ending added, on any usual system."""
    separators = "/" in name or "\\" in name
    return bool(name.strip(". ")) and not separators and name.isprintable() and len(name) <= 200


def _validate_camera(camera: Camera, where: str) -> None:
    """What `Camera` lets pass and no photograph has."""
    import torch

    rotation = camera.world_to_camera[:3, :3]
    residual = float((rotation @ rotation.T - torch.eye(3, dtype=rotation.dtype)).abs().max())
    if residual > _ROTATION_TOLERANCE:
        raise SceneError(
            f"the rotation is not orthonormal (off by {residual:.2g})",
            where=where,
            fix="write poses with more digits, and without scale",
        )
    if camera.world_to_camera[:3, 3].abs().max() > _FARTHEST:
        raise SceneError(
            "the camera stands too far away for single precision",
            where=where,
            fix="scale or move the scene so that positions stay below 1e9",
        )
    size = max(camera.width, camera.height)
    for name in ("fx", "fy"):
        focal = getattr(camera, name)
        if not size * _FOCAL_RANGE[0] < focal < size * _FOCAL_RANGE[1]:
            raise SceneError(
                f"the focal length {name} is {focal:g} px for an image of "
                f"{camera.width}x{camera.height}",
                where=where,
                fix="check whether the focal length belongs to another image size or unit",
            )


def _validate_maps(view: View, where: str) -> None:
    """The mask, the alpha and the depth."""
    import torch

    for name, array in (("mask", view.mask), ("alpha", view.alpha), ("depth", view.depth)):
        if array is not None and array.shape != view.image.shape[:2]:
            raise SceneError(
                f"the {name} has shape {tuple(array.shape)}, not {tuple(view.image.shape[:2])}",
                where=where,
                fix="resize it as its photograph",
            )
    if view.mask is not None and view.mask.dtype != torch.bool:
        raise SceneError(
            f"the mask is {view.mask.dtype}, not bool",
            where=where,
            fix="compare it with a threshold",
        )
    if view.mask is not None and not view.mask.any():
        raise SceneError(
            "the mask leaves no pixel to measure", where=where, fix="take the mask or the view out"
        )
    if view.alpha is not None:
        low, high = view.alpha.aminmax()
        if not 0 <= low <= high <= 1:
            raise SceneError(
                "the alpha has values outside [0, 1] or not finite",
                where=where,
                fix="divide 8-bit values by 255",
            )
    if view.depth is not None and not (torch.isfinite(view.depth).all() and view.depth.min() >= 0):
        raise SceneError(
            "the depth has values that are negative or not finite",
            where=where,
            fix="write 0 where it is not known",
        )


def _without_equal_poses(scene: Scene) -> Scene:
    """Leave out training views whose pose an earlier one has: they have no parallax.

    Raises:
        SceneError: fewer than three others would be left; one of the poses is most likely a copy.
    """
    kept: list[View] = []
    copies: list[tuple[View, View]] = []
    for view in scene.train:
        twin = next((other for other in kept if _same_pose(view, other)), None)
        if twin is None:
            kept.append(view)
        else:
            copies.append((twin, view))
    if not copies:
        return scene
    if len(kept) < _FEWEST_BESIDE_COPIES:
        first, second = copies[0]
        raise SceneError(
            f"the training views {first.name!r} and {second.name!r} have the same pose: "
            "two photographs from one place say nothing about depth",
            where=scene.name,
            fix="leave one of them out, or correct its pose",
        )
    for first, second in copies:
        _log.warning(
            "%s: the training views %s and %s have the same pose; %s is left out",
            *(scene.name, first.name, second.name, second.name),
        )
    fact = Fact("left_out_for_equal_pose", ", ".join(view.name for _, view in copies))
    return replace(scene, train=tuple(kept), facts=(*scene.facts, fact))


def _same_pose(view: View, other: View) -> bool:
    import torch

    first, second = view.camera.world_to_camera, other.camera.world_to_camera
    return torch.allclose(first, second, rtol=1e-9, atol=1e-9)


def _validate_facts(scene: Scene) -> None:
    names = [fact.name for fact in scene.facts]
    for fact in scene.facts:
        if not _FACT_NAME.fullmatch(fact.name) or names.count(fact.name) > 1:
            raise SceneError(
                f"the fact {fact.name!r} has no plain name of its own",
                where=scene.name,
                fix="letters, digits, '-' and '_'; each name once",
            )
        numbers = fact.value if isinstance(fact.value, tuple) else (fact.value,)
        if not all(isinstance(n, str) or math.isfinite(n) for n in numbers):
            raise SceneError(
                f"the fact {fact.name!r} is not finite",
                where=scene.name,
                fix="leave it out, or say it in words",
            )


def check_points(points: PointCloud, where: str = "") -> None:
    """Check the shape and values of positions, colours, scales and opacities.

    Raises:
        SceneError: a shape is wrong, a value is not finite, a scale is not positive, or an opacity is
            not in (0, 1).
    """
    import torch

    count = len(points)
    shapes = {
        "positions": (count, 3),
        "colors": (count, 3),
        "scales": (count,),
        "opacities": (count,),
    }
    for name, shape in shapes.items():
        values: Tensor | None = getattr(points, name)
        if values is None:
            continue
        if tuple(values.shape) != shape:
            raise SceneError(
                f"points.{name} has the shape {tuple(values.shape)}, expected {shape}",
                where=where,
                fix="give each point three coordinates and three colour values",
            )
        good = finite = torch.isfinite(values)
        if name == "scales":
            good = finite & (values > 0)
        elif name == "opacities":
            good = finite & (values > 0) & (values < 1)
        if not good.all():
            index = int((~good).reshape(count, -1).any(dim=1).nonzero()[0])
            raise SceneError(
                f"points.{name}[{index}] is "
                + (
                    f"{values[index].tolist()}, which is not valid"
                    if finite[index].all()
                    else "not finite"
                ),
                where=where,
                fix="leave such points out",
            )
