"""Properties of views and points."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from core_rasterizer import Camera, Gaussians, rasterize
from registry import PointCloud, SceneError
from registry.priors import DepthMap
from registry.testing import tiny_scene
from tests.host import TrainingSettings, initial_gaussians

SETTINGS = TrainingSettings()


def test_solid_pixels_are_those_without_background() -> None:
    view = tiny_scene().train[0]
    assert view.solid is None
    levels = torch.tensor([[0, 1, 128], [252, 253, 255]])
    solid = replace(view, alpha=levels / 255).solid
    assert solid is not None
    assert solid.tolist() == [[False, False, False], [False, True, True]]


def elongated() -> Gaussians:
    """Return Gaussians that look different from every side."""
    generator = torch.Generator().manual_seed(2)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    means = random(20, 3) * 0.5 + torch.tensor([0.0, 0, 3])
    return Gaussians(means, random(20, 3) - 2, random(20, 4), random(20), random(20, 16, 3) / 4)


def image(gaussians: Gaussians, camera: Camera) -> Tensor:
    scales, opacities = gaussians.log_scales.exp(), gaussians.opacity_logits.sigmoid()
    given = gaussians.means, gaussians.quaternions, scales, opacities, gaussians.sh
    return rasterize(*given, camera).rgb


def test_points_keep_the_shape_and_the_colours_of_gaussians() -> None:
    gaussians = elongated()
    started = initial_gaussians(PointCloud.of_gaussians(gaussians), SETTINGS)
    for name, values in vars(gaussians).items():
        torch.testing.assert_close(getattr(started, name), values, atol=1e-5, rtol=1e-5)
    lower = initial_gaussians(PointCloud.of_gaussians(gaussians), TrainingSettings(sh_degree=1))
    assert torch.equal(lower.sh, gaussians.sh[:, :4])


def test_transformed_points_look_the_same_from_transformed_cameras() -> None:
    camera = tiny_scene().train[0].camera
    turn = torch.from_numpy(Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
    similarity = torch.eye(4, dtype=torch.float64)
    similarity[:3, :3], similarity[:3, 3] = 1.5 * turn, torch.tensor([2.0, -1, 0.5])
    pose = similarity @ camera.camera_to_world
    pose[:3, :3] /= 1.5
    moved = replace(camera, world_to_camera=torch.linalg.inv(pose))
    points = PointCloud.of_gaussians(elongated())
    for cloud in (points, replace(points, quaternions=None), replace(points, sh=None)):
        expected = image(initial_gaussians(cloud, SETTINGS), camera)
        started = initial_gaussians(cloud.transformed(similarity), SETTINGS)
        torch.testing.assert_close(image(started, moved), expected, atol=2e-4, rtol=0)
    depth = DepthMap(torch.full((2, 2), 3.0), torch.ones(2, 2).bool(), torch.ones(2, 2))
    scaled = replace(points, maps={"view": depth}).transformed(similarity).maps["view"]
    torch.testing.assert_close(scaled.depth, torch.full((2, 2), 4.5))
    with pytest.raises(SceneError, match="mirrors"):
        points.transformed(torch.diag(torch.tensor([1.0, 1, -1, 1])))


def test_a_subset_and_another_frame_keep_every_property() -> None:
    kinds = {"even": torch.arange(20) % 2 == 0}
    points = replace(PointCloud.of_gaussians(elongated()), kinds=kinds)
    half = points.subset(kinds["even"])
    assert half.kinds["even"].tolist() == [True] * 10
    assert half.sh is not None
    assert points.sh is not None
    assert torch.equal(half.sh, points.sh[::2])
    scene = replace(tiny_scene(), points=points)
    framed = scene.in_frame()
    assert framed.points is not None
    started, expected = (
        image(initial_gaussians(p, SETTINGS), s.train[0].camera)
        for p, s in ((framed.points, framed), (points, scene))
    )
    torch.testing.assert_close(started, expected, atol=1e-4, rtol=0)
