"""Checks that every scene passes after loading.

Each check is a generator of faults: what is wrong, and how to fix it. The first fault is raised, and
later checks may rely on earlier ones.
"""

from __future__ import annotations

import json
import logging
import math
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ...errors import SceneError
from ...messages.visible_text import is_plain_name
from ...system.files import jsonable
from ..scene import DepthMap, Fact, PointCloud, Scene, TrainingScene, View

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

Faults = Iterator[tuple[str, str]]

_FACT_NAME = re.compile(r"[A-Za-z0-9_-]+")
_NOT_ON_WINDOWS = re.compile(
    r'[<>:"|?*]|[. ]$|^(con|prn|aux|nul|com\d|lpt\d) *(\.|$)', re.IGNORECASE
)
_ROTATION_TOLERANCE = 1e-4
_FARTHEST = 1e9
"""World units; beyond, squares and products of positions leave single precision."""
_MIN_VIEWS_WITHOUT_COPIES = 3
"""Training views that a scene must have beside those that are left out."""
_FOCAL_RANGE = (1e-2, 1e4)
"""In units of the longer side of the image: from 179 degrees of view to 20 seconds of arc."""
_MAX_FACTS = 1_000_000
"""Characters of the initializer's facts as JSON."""
_log = logging.getLogger("stereogs.scene")


def validate(scene: Scene) -> Scene:
    """Return the scene if training can use it.

    Of training views with the same pose the first stays, if at least three views do; a warning and a fact
    name the others.

    Raises:
        SceneError: no training view; a repeated or unsafe name; views with the same pose; a rotation
            that is not orthonormal (to 1e-4); a focal length or position out of range; an image, mask, alpha,
            weights or depth of another size than the camera's, or with values out of range; a mask without
            pixels; points that are not finite or have colours outside [0, 1]; bounds out of order; a fact
            with a repeated or unsafe name or a value that is not finite.
    """
    if not scene.train:
        fix = "check the folder and the split"
        raise SceneError("the scene has no training view", where=scene.name, fix=fix)
    if not is_plain_name(scene.name):
        fix = "give it a visible name of at most 200 characters"
        raise SceneError(f"the scene's name is {scene.name!r}", fix=fix)
    seen: set[str] = set()
    for view in (*scene.train, *scene.test):
        _raise_first(_view_faults(view), f"{scene.name}, view {view.name!r}")
        if view.name in seen:
            fault = f"two views are named {view.name!r}"
            raise SceneError(fault, where=scene.name, fix="rename one of them")
        seen.add(view.name)
    scene = _without_equal_poses(scene)
    _raise_first(_scene_faults(scene), scene.name)
    return scene


def check_points(points: PointCloud, where: str = "") -> None:
    """Check the shapes and values of all properties of points.

    Raises:
        SceneError: a shape is wrong, a value is not finite, a scale is not positive, an opacity is not in
            (0, 1), a quaternion is zero, or a colour is far outside [0, 1], as one of 0 to 255 is.
    """
    _raise_first(_point_faults(points), where)


def check_maps(maps: Mapping[str, DepthMap], scene: TrainingScene) -> None:
    """Check that depth maps are of training views, in their size.

    Raises:
        SceneError: a view is unknown, a map has another size, or a depth is negative or not finite.
    """
    sizes = {view.name: view.image.shape[:2] for view in scene.train}
    for name, known in maps.items():
        if name not in sizes:
            raise SceneError(f"there is a depth map of {name!r}, which is not a training view")
        if any(value.shape != sizes[name] for value in vars(known).values()):
            raise SceneError(
                f"the depth map of {name!r} does not have the size of its view, {tuple(sizes[name])}"
            )
        if not (known.depth.isfinite().all() and known.depth.min() >= 0):
            raise SceneError(f"the depth map of {name!r} has values below 0 or not finite")


def check_initialization(points: PointCloud, scene: TrainingScene, *priors: Any) -> PointCloud:
    """Check an initializer's answer: its points, depth maps, kinds, facts and pictures.

    Raises:
        SceneError: the points are empty; a position, colour, scale or opacity is out of range; a depth map
            does not fit its view; a picture's name is not a file name; or a kind is not a mask of the points.
    """
    import torch

    check_maps(points.maps, scene)
    for name in points.pictures:
        if not is_file_name(name):
            raise SceneError(f"the picture {name!r} has no plain file name")
    count = len(points)
    if count == 0:
        raise SceneError(
            "the initializer found no points to start from",
            fix="use more or better overlapping views, or another one: --set initializer.use=random",
        )
    for name, mask in points.kinds.items():
        if not is_file_name(name) or "," in name:
            raise SceneError(f"the kind {name!r} of points has no plain name")
        if mask.dtype != torch.bool or tuple(mask.shape) != (count,):
            raise SceneError(
                f"points.kinds[{name!r}] is {mask.dtype} of shape {tuple(mask.shape)}, "
                f"expected a bool for each of {count} points"
            )
    check_points(points)
    try:
        size = len(json.dumps(jsonable(dict(points.facts))))
    except (TypeError, ValueError) as error:
        raise SceneError(f"the initializer's facts are not plain values: {error}") from error
    if size > _MAX_FACTS or not all(is_plain_name(name) for name in points.facts):
        raise SceneError(
            "the initializer's facts do not have plain names, or take more than a megabyte",
            fix="use printable texts of at most 200 characters as names",
        )
    return points


def is_file_name(name: str) -> bool:
    """Whether a name, with an extension added, is the name of one file in a folder."""
    if sys.platform == "win32" and _NOT_ON_WINDOWS.search(name):
        return False
    separators = "/" in name or "\\" in name
    return bool(name.strip(". ")) and not separators and name.isprintable() and len(name) <= 200


def _raise_first(faults: Faults, where: str) -> None:
    for what, fix in faults:
        raise SceneError(what, where=where, fix=fix)


def _view_faults(view: View) -> Faults:
    camera, image = view.camera, view.image
    if not is_file_name(view.name):
        yield (
            "a view's name must be a plain file name",
            "at most 200 printable characters, no slashes, not dots alone",
        )
    yield from _camera_faults(camera)
    if image.shape != (camera.height, camera.width, 3):
        yield (
            f"the image has shape {tuple(image.shape)} but its camera is {_size(camera)}",
            "use images of one size, the size that the poses were made for",
        )
    if not _in_unit_range(image):
        yield (
            "the image has values outside [0, 1] or not finite",
            "divide 8-bit values by 255, and leave damaged pixels to the mask",
        )
    yield from _map_faults(view)


def _camera_faults(camera: Camera) -> Faults:
    """Faults that `Camera` itself does not refuse."""
    import torch

    rotation = camera.world_to_camera[:3, :3]
    residual = float((rotation @ rotation.T - torch.eye(3, dtype=rotation.dtype)).abs().max())
    if residual > _ROTATION_TOLERANCE:
        yield (
            f"the rotation is not orthonormal (off by {residual:.2g})",
            "write poses with more digits, and without scale",
        )
    if camera.world_to_camera[:3, 3].abs().max() > _FARTHEST:
        yield (
            "the camera is too far away for single precision",
            "scale or move the scene so that positions stay below 1e9",
        )
    longer = max(camera.width, camera.height)
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        if not longer * _FOCAL_RANGE[0] < focal < longer * _FOCAL_RANGE[1]:
            yield (
                f"the focal length {name} is {focal:g} px for an image of {_size(camera)}",
                "check whether the focal length belongs to another image size or unit",
            )


def _map_faults(view: View) -> Faults:
    """Faults of the mask, the alpha and the depth, and of the types of all."""
    import torch

    mask, alpha, weights, depth = view.mask, view.alpha, view.weights, view.depth
    size = tuple(view.image.shape[:2])
    dtypes = {"mask": torch.bool} | dict.fromkeys(
        ("image", "alpha", "weights", "depth"), torch.float32
    )
    for name, dtype in dtypes.items():
        array: Tensor | None = getattr(view, name)
        if array is not None and name != "image" and array.shape != size:
            yield f"the {name} has shape {tuple(array.shape)}, not {size}", "resize it to its image"
        if array is not None and array.dtype != dtype:
            yield f"the {name} is {array.dtype}, not {dtype}", f"convert it with .to({dtype})"
    if mask is not None and not mask.any():
        yield "the mask leaves no pixel to measure", "remove the mask or the view"
    if weights is not None and not (_in_unit_range(weights) and weights.any()):
        yield "the weights are outside [0, 1], not finite or all 0", "remove them or the view"
    if alpha is not None and not _in_unit_range(alpha):
        yield "the alpha has values outside [0, 1] or not finite", "divide 8-bit values by 255"
    if depth is not None and not (torch.isfinite(depth).all() and depth.min() >= 0):
        yield "the depth has values that are negative or not finite", "write 0 for unknown depth"


def _scene_faults(scene: Scene) -> Faults:
    near, far = scene.bounds
    if not 0 < near < far < float("inf"):
        yield (
            f"the depth bounds are ({near:g}, {far:g}); they must satisfy 0 < near < far",
            "correct them in the file or the code that they come from",
        )
    if scene.points is not None:
        yield from _point_faults(scene.points)
        if len(scene.points) and not _in_unit_range(scene.points.colors):
            yield "the points have colours outside [0, 1]", "divide 8-bit values by 255"
    names = [fact.name for fact in scene.facts]
    for fact in scene.facts:
        if not _FACT_NAME.fullmatch(fact.name) or names.count(fact.name) > 1:
            yield (
                f"the fact {fact.name!r} does not have a plain, unique name",
                "letters, digits, '-' and '_'; each name once",
            )
        numbers = fact.value if isinstance(fact.value, tuple) else (fact.value,)
        if not all(isinstance(n, str) or math.isfinite(n) for n in numbers):
            yield f"the fact {fact.name!r} is not finite", "leave it out, or write it in words"


def _point_faults(points: PointCloud) -> Faults:
    import torch

    count = len(points)
    shapes: dict[str, list[tuple[int, ...]]] = {
        "positions": [(count, 3)],
        "colors": [(count, 3)],
        "scales": [(count,), (count, 3)],
        "opacities": [(count,)],
        "quaternions": [(count, 4)],
        "sh": [(count, 1, 3), (count, 4, 3), (count, 9, 3), (count, 16, 3)],
    }
    ranges = {"scales": (0.0, math.inf), "opacities": (0.0, 1.0), "colors": (-1.0, 2.0)}
    for name, allowed in shapes.items():
        values: Tensor | None = getattr(points, name)
        if values is None:
            continue
        if tuple(values.shape) not in allowed:
            yield (
                f"points.{name} has the shape {tuple(values.shape)}, "
                f"expected {' or '.join(map(str, allowed))}",
                "give each point its own row; `registry.PointCloud` documents the shapes",
            )
        finite = torch.isfinite(values)
        low, high = ranges.get(name, (-math.inf, math.inf))
        good = finite & (low < values) & (values < high)
        if name == "quaternions":
            good &= values.norm(dim=1, keepdim=True) > 0
        if not good.all():
            index = int((~good).reshape(count, -1).any(dim=1).nonzero()[0])
            given = values[index].tolist()
            fault = f"{given}, which is not valid" if finite[index].all() else "not finite"
            yield f"points.{name}[{index}] is {fault}", "leave it out; colours are 0 to 1"


def _without_equal_poses(scene: Scene) -> Scene:
    """Leave out training views with the pose of an earlier one: they have no parallax.

    Raises:
        SceneError: fewer than three others would be left; one of the poses is most likely a copy.
    """
    import torch

    poses = torch.stack([view.camera.world_to_camera for view in scene.train])
    kept: list[int] = []
    copies: list[tuple[View, View]] = []
    for index, view in enumerate(scene.train):
        twins = _same_pose(poses[index], poses[kept], scene.bounds[0]).nonzero()
        if len(twins):
            copies.append((scene.train[kept[int(twins[0])]], view))
        else:
            kept.append(index)
    if not copies:
        return scene
    if len(kept) < _MIN_VIEWS_WITHOUT_COPIES:
        first, second = copies[0]
        raise SceneError(
            f"the training views {first.name!r} and {second.name!r} have the same pose: "
            "photographs from one position contain no depth",
            where=scene.name,
            fix="leave one of them out, or correct its pose",
        )
    for first, second in copies:
        _log.warning(
            "%s: the training views %s and %s have the same pose; %s is left out",
            *(scene.name, first.name, second.name, second.name),
        )
    fact = Fact("left_out_for_equal_pose", ", ".join(view.name for _, view in copies))
    train = tuple(scene.train[index] for index in kept)
    return replace(scene, train=train, facts=(*scene.facts, fact))


def _same_pose(pose: Tensor, others: Tensor, near: float) -> Tensor:
    """Which poses `[N, 4, 4]` differ from a pose by rounding only; `near` is the near bound of the scene."""
    turned = (pose[:3, :3] - others[:, :3, :3]).abs().amax(dim=(1, 2))
    shift = (pose[:3, 3] - others[:, :3, 3]).abs().amax(dim=1)
    rounding = 1e-14 * float(pose[:3, 3].abs().max())
    return (turned <= 1e-9) & (shift <= max(1e-9 * near, rounding))


def _in_unit_range(values: Tensor) -> bool:
    low, high = values.aminmax()  # one pass; a NaN becomes both and compares as false
    return bool(0 <= low <= high <= 1)


def _size(camera: Camera) -> str:
    return f"{camera.width}x{camera.height}"
