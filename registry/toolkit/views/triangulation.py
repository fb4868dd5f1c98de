"""Triangulate points from a few photographs with known cameras, with pycolmap on the CPU.

    points = triangulated_points(scene, seed=self.context.seed)

SIFT features are matched along the epipolar lines of the known poses ("guided"). With three photographs
this finds about 1.4 times the points of unguided matching; the result is deterministic.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from core_rasterizer.matching import source_views
from registry.toolkit.images import grey

from ...contract.scene import PointCloud
from ...errors import SceneError
from ..photos.lens import import_pycolmap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera

    from ...contract.scene import TrainingScene, TrainingView

CONTRAST_THRESHOLD = 0.002
"""Contrast threshold of SIFT features; COLMAP's 0.0067 suits dozens of photographs, not three."""
MAX_PARTNERS = 8
"""Partners that each photograph is matched with, so that time grows linearly."""
BOUNDS_MARGIN = 1.1
"""Points nearer than near / margin or farther than far * margin count as wrong matches."""


@dataclass(frozen=True, eq=False)
class Triangulation:
    """P points that at least two photographs observe.

    Args:
        positions: `[P, 3]` float32, world units.
        colors: `[P, 3]` float32 in [0, 1], mean over the photographs that observe the point.
        errors: `[P]` float32 mean reprojection error, pixels.
        seen_by: `[P, V]` bool, True for the two or more of V photographs that observe the point.
    """

    positions: Tensor
    colors: Tensor
    errors: Tensor
    seen_by: Tensor


class _Features(NamedTuple):
    matched: tuple[Any, Any, Any]  # pycolmap's keypoints, descriptors and camera
    pixels: NDArray[np.float64]  # [F, 2], center of the top-left pixel at (0.5, 0.5)


def triangulated_points(
    scene: TrainingScene, *, max_reprojection_error: float = 2.0, min_angle: float = 1.5, seed: int
) -> PointCloud:
    """Return at least one point, from the training photographs only and within the scene's bounds.

    Args:
        max_reprojection_error, min_angle, seed: See `triangulate`.

    Raises:
        SceneError: The scene has one training view, or no point is found.
    """
    if len(scene.train) < 2:
        raise SceneError(
            "points cannot be triangulated from one training view",
            where=scene.name,
            fix="use two or more training views, or the initializer `random`",
        )
    limits = {"max_reprojection_error": max_reprojection_error, "min_angle": min_angle}
    found = triangulate(scene.train, scene.bounds, **limits, seed=seed)
    keep = _within_bounds(found, scene)
    if not keep.any():
        raise SceneError(
            f"no point could be triangulated from the {len(scene.train)} training views",
            where=scene.name,
            fix="use the initializer `random`, add training views that overlap, or raise "
            "`max_reprojection_error` if the poses are rough",
        )
    return PointCloud(positions=found.positions[keep], colors=found.colors[keep])


def triangulate(
    views: Sequence[TrainingView],
    bounds: tuple[float, float],
    *,
    max_reprojection_error: float,
    min_angle: float,
    seed: int,
) -> Triangulation:
    """Triangulate points; poses and intrinsics stay fixed.

    Args:
        views: At least two photographs. Each is matched with up to eight that see the same content from
            a short baseline.
        bounds: (near, far) z-depth of the scene's content, world units; points may lie outside.
        max_reprojection_error: Largest reprojection error and distance from epipolar lines, pixels.
        min_angle: Smallest angle between two rays of a point, degrees.
        seed: Seed of pycolmap's random choices.
    """
    colmap = import_pycolmap()
    features = [_extract(colmap, k, view) for k, view in enumerate(views, start=1)]
    model = colmap.Reconstruction()
    for k, (view, feature) in enumerate(zip(views, features, strict=True), start=1):
        pose = view.camera.world_to_camera.numpy()
        model.add_camera_with_trivial_rig(feature.matched[2])
        image = colmap.Image(name=view.name, camera_id=k, image_id=k)
        rigid = colmap.Rigid3d(colmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
        model.add_image_with_trivial_frame(image, rigid)
    pairs = pairs_to_match([view.camera for view in views], bounds)
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        folder = Path(name)
        with colmap.Database.open(folder / "matches.db") as database:
            for k, feature in enumerate(features, start=1):
                database.write_camera(feature.matched[2], True)
                database.write_rig(model.rig(k), True)
                database.write_frame(model.frame(k), True)
                database.write_image(model.image(k), True)
                database.write_keypoints(k, feature.pixels.astype(np.float32))
            _write_matches(colmap, database, model, features, pairs, max_reprojection_error)
        options = _options(colmap, max_reprojection_error, min_angle, seed)
        result = colmap.triangulate_points(
            model, folder / "matches.db", folder, folder, options=options
        )
    return _collect(result, views, features)


def pairs_to_match(cameras: Sequence[Camera], bounds: tuple[float, float]) -> list[tuple[int, int]]:
    """Return the index pairs of photographs to match: all of up to nine, else likely partners of each.

    Args:
        bounds: (near, far) z-depth of the scene's content, world units.
    """
    found = {
        (min(index, partner), max(index, partner))
        for index, partners in enumerate(source_views(cameras, MAX_PARTNERS, bounds))
        for partner in partners
    }
    return sorted(found)


def _extract(colmap: Any, identity: int, view: TrainingView) -> _Features:
    options = colmap.FeatureExtractionOptions()
    options.num_threads = 1
    options.sift.peak_threshold = CONTRAST_THRESHOLD
    extractor = colmap.FeatureExtractor.create(options, colmap.Device.cpu)
    brightness = grey(view.image).clamp(0, 1)
    keypoints, descriptors = extractor.extract_from_uint8_array(
        (255 * brightness).round().to(torch.uint8).numpy()
    )
    lens = view.camera
    camera = colmap.Camera.create_from_model_id(
        identity, colmap.CameraModelId.PINHOLE, lens.fx, lens.width, lens.height
    )
    camera.params = [lens.fx, lens.fy, lens.cx, lens.cy]
    pixels = colmap.keypoints_to_matrix(keypoints)[:, :2].astype(np.float64)
    if view.trained is not None:
        column, row = pixels.astype(int).clip(0, [lens.width - 1, lens.height - 1]).T
        kept = view.trained.numpy()[row, column]
        pixels = pixels[kept]
        keypoints = colmap.FeatureKeypoints(
            [k for k, is_kept in zip(keypoints, kept, strict=True) if is_kept]
        )
        descriptors = colmap.FeatureDescriptors(descriptors.type, descriptors.data[kept])
    return _Features((keypoints, descriptors, camera), pixels)


def _write_matches(
    colmap: Any,
    database: Any,
    model: Any,
    features: list[_Features],
    pairs: list[tuple[int, int]],
    max_error: float,
) -> None:
    options = colmap.FeatureMatchingOptions()
    options.num_threads = 1
    matcher = colmap.FeatureMatcher.create(options, colmap.Device.cpu)
    poses = [model.image(k).cam_from_world() for k in range(1, len(features) + 1)]
    for first, second in pairs:
        relative = poses[second] * poses[first].inverse()
        geometry = colmap.TwoViewGeometry()
        geometry.config = colmap.TwoViewGeometryConfiguration.CALIBRATED
        geometry.E = colmap.essential_matrix_from_pose(relative)
        geometry.cam2_from_cam1 = relative
        here, there = features[first], features[second]
        if len(here.pixels) and len(there.pixels):
            matcher.match_guided(max_error, *here.matched, *there.matched, geometry)
        database.write_two_view_geometry(first + 1, second + 1, geometry)


def _options(colmap: Any, max_error: float, min_angle: float, seed: int) -> Any:
    options = colmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    for stage in (options, options.mapper, options.triangulation):
        stage.random_seed = seed % 2**31
    options.extract_colors = False
    options.min_num_matches = 1
    # With few training views, most points are observed by only two.
    options.triangulation.ignore_two_view_tracks = False
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = min_angle
    options.mapper.filter_max_reproj_error = max_error
    return options


def _collect(model: Any, views: Sequence[TrainingView], features: list[_Features]) -> Triangulation:
    points = [model.points3D[key] for key in sorted(model.points3D)]
    colors = np.zeros((len(points), 3), dtype=np.float32)
    seen_by = torch.zeros(len(points), len(views), dtype=torch.bool)
    for index, point in enumerate(points):
        features_of_point = [(e.image_id - 1, e.point2D_idx) for e in point.track.elements]
        seen_by[index, [view for view, _ in features_of_point]] = True
        colors[index] = np.mean(
            [_color(views[k], features[k].pixels[feature]) for k, feature in features_of_point],
            axis=0,
        )
    positions = np.array([point.xyz for point in points], dtype=np.float32).reshape(-1, 3)
    return Triangulation(
        positions=torch.from_numpy(positions),
        colors=torch.from_numpy(colors),
        errors=torch.tensor([point.error for point in points], dtype=torch.float32),
        seen_by=seen_by,
    )


def _color(view: TrainingView, pixel: NDArray[np.float64]) -> NDArray[np.float32]:
    column, row = pixel.astype(int).clip(0, [view.camera.width - 1, view.camera.height - 1])
    color: NDArray[np.float32] = view.image[row, column].numpy()
    return color


def _within_bounds(found: Triangulation, scene: TrainingScene) -> Tensor:
    """Return `[P]` bool: the z-depth is within the bounds in all views that observe the point."""
    near, far = scene.bounds[0] / BOUNDS_MARGIN, scene.bounds[1] * BOUNDS_MARGIN
    keep = torch.ones(len(found.positions), dtype=torch.bool)
    for index, view in enumerate(scene.train):
        _, _, depth = view.camera.project(found.positions)
        keep &= ~found.seen_by[:, index] | ((depth > near) & (depth < far))
    return keep
