"""The 3D view's page part, the distance to the subject, and the exported page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry.testing import tiny_scene
from stereogs_plugins.reports.html.exporter import HtmlExporter, stereogs_register_exporters
from stereogs_plugins.reports.html.reach import reaches
from stereogs_plugins.reports.html.scene_view import pack
from tests.html_page import Page
from tests.stereogs_plugins.building import build, offered

SCENE = tiny_scene()


def ball(center: tuple[float, float, float], radius: float) -> Gaussians:
    """Small opaque Gaussians on a sphere."""
    directions = torch.randn(400, 3, generator=torch.Generator().manual_seed(1))
    directions = torch.nn.functional.normalize(directions, dim=1)
    means = torch.tensor(center) + radius * directions
    sizes = torch.full((400,), 0.05)
    return Gaussians.from_points(means, directions.abs(), sizes, torch.full((400,), 0.9), 0)


def looking_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    """A camera whose vertical axis is the world's y."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ eye
    return Camera.centered(pose, 60.0, 64, 48)


def test_axes_that_meet_give_the_middle_of_the_subject() -> None:
    eyes = [(4.0, 1.0, 0.0), (0.0, 1.5, 4.0), (-5.0, 1.0, 0.0), (0.0, 2.0, -4.0)]
    cameras = [looking_at(eye, (0.0, 0.0, 0.0)) for eye in eyes]
    expected = [float(np.linalg.norm(eye)) for eye in eyes]
    assert reaches(ball((0, 0, 0), 1.0), cameras) == pytest.approx(expected, rel=0.1)


def test_parallel_axes_give_the_depth_of_what_is_in_front() -> None:
    cameras = [looking_at((x, 0.0, 0.0), (x, 0.0, 1.0)) for x in (-0.2, 0.0, 0.2)]
    found = reaches(ball((0, 0, 6), 1.0), cameras)
    assert found == pytest.approx([5.3, 5.3, 5.3], abs=0.5), "the side that is seen"


def test_part_of_the_gaussians_gives_many_cameras_the_same_distance() -> None:
    camera = looking_at((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    few, many = (reaches(ball((0, 0, 6), 1.0), [camera] * count) for count in (24, 49))
    assert many == pytest.approx([few[0]] * 49, rel=0.05)


def test_a_camera_that_sees_nothing_has_a_distance_too() -> None:
    assert reaches(ball((0, 0, 6), 1.0), [looking_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))])[0] > 0


def setup_of(page: str) -> dict[str, Any]:
    return dict(json.loads(page.split('id="scene-setup">')[1].split("</script>")[0]))


def test_the_exporter_is_offered_as_html() -> None:
    assert offered(stereogs_register_exporters) == {"html": HtmlExporter}


def test_the_exported_page_is_one_file(tmp_path: Path) -> None:
    model = GaussianModel(
        ball((0, 0, 3), 1.0), open_device(), dilation=0.125, compensate_dilation=True
    )
    (file,) = build(HtmlExporter).export(model.reader(), SCENE, tmp_path)
    assert [*tmp_path.iterdir()] == [file]
    page = file.read_text("utf-8")
    assert Page(page).loads == []
    assert 'id="scene-data"' in page
    assert 'id="viewer-data"' in page
    assert "MIT License" in page
    setup = setup_of(page)
    assert (setup["dilation"], setup["compensate"]) == (0.125, True)
    assert [view["train"] for view in setup["views"]] == [True] * len(SCENE.train) + [False] * len(
        SCENE.test
    )


def test_a_view_is_where_its_camera_is() -> None:
    gaussians = ball((0, 0, 3), 1.0)
    packed = pack(gaussians, SCENE, 0.3, False)
    views = packed.setup["views"]
    places = np.array([np.reshape(view["pose"], (4, 4))[:3, 3] for view in views])
    centers = np.array([view.camera.center.numpy() for view in (*SCENE.train, *SCENE.test)])
    near, far = np.linalg.norm(places[0] - places[1]), np.linalg.norm(centers[0] - centers[1])
    first = reaches(gaussians, [view.camera for view in (*SCENE.train, *SCENE.test)])[0]
    assert views[0]["reach"] / first == pytest.approx(near / far)
    assert packed.setup["shown"] < 1, "photographs without alpha may be cropped"
