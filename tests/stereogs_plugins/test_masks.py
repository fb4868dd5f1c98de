"""Masks exclude pixels from training: what only they show is in no point, no loss and no render."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch

import stereogs
from core_rasterizer import Camera, Rendering
from registry import PointCloud, Scene, View
from registry.testing import step_of
from stereogs_plugins.exporters.colmap import ColmapExporter
from stereogs_plugins.exporters.transforms import TransformsExporter
from stereogs_plugins.priors.depth_cues import DepthCues
from stereogs_plugins.priors.sgm import SgmPrior
from stereogs_plugins.regularizers.distant_l1 import DistantL1
from stereogs_plugins.regularizers.empty_background import EmptyBackground
from stereogs_plugins.regularizers.known_depth import DepthRanking
from stereogs_plugins.regularizers.pearson_depth import PearsonDepth
from stereogs_plugins.regularizers.stereo_depth import StereoDepth
from stereogs_plugins.regularizers.virtual_stereo import VirtualStereo
from stereogs_plugins.scenes.colmap import ColmapScene
from stereogs_plugins.scenes.nerfstudio import NerfstudioScene
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build

PLACE = torch.tensor([[0.0, 0.1, 2.2]])
HALF = 14
"""Half the side of the painted square, pixels."""
PAINT = torch.tensor([1.0, 0.0, 1.0])
"""A colour that the room does not have."""
TERMS = [
    "virtual_stereo",
    "cycle_filtered_warping",
    "forward_warping",
    {"use": "distant_l1", "share": 1.0},
    {"use": "stereo_depth", "weight": 0.1},
]
DENSE = {
    **{"use": "consistency_dense", "min_component": 1, "stride": 2, "hand_on_depth": True},
    **dict.fromkeys(("fill", "back_layer", "margin", "merge"), True),
}
INITIALIZERS: dict[str, Any] = {
    "dense": DENSE,
    "features": {"use": "sfm", "source": "triangulate"},
    "flow": {"use": "flow_epipolar", "stride": 3},
    "matches": "matched_points",
    "random": {"use": "random", "count": 3000},
}
PRIORS = ["plane_sweep", "depth_cues", "dis_flow", "sift_matches", "sgm"]


@cache
def room() -> Scene:
    return build(ProceduralScene, width=96, height=72, points=300, test_views=1).load()


def square(camera: Camera) -> tuple[slice, slice]:
    """Where the photograph of a camera shows the object: the same place in the world."""
    u, v, _ = (int(value) for value in camera.project(PLACE))
    return slice(max(0, v - HALF), v + HALF), slice(max(0, u - HALF), u + HALF)


def painted(view: View, masked: bool) -> View:
    image, weights = view.image.clone(), torch.ones(view.image.shape[:2])
    image[square(view.camera)] = PAINT * (0.7 + 0.3 * torch.rand(2 * HALF, 2 * HALF, 1))
    weights[square(view.camera)] = 0
    return replace(view, image=image, weights=weights if masked else None)


def scene(masked: bool) -> Scene:
    torch.manual_seed(0)
    views = tuple(painted(view, masked) for view in room().train)
    points = room().points
    return replace(room(), train=views, points=points)


def amount(colors: Any) -> float:
    """Share of colours that are nearly the paint."""
    red, green, blue = torch.as_tensor(colors).reshape(-1, 3).unbind(1)
    return float(((red > green + 0.35) & (blue > green + 0.35)).float().mean())


def trained(masked: bool, **parts: Any) -> stereogs.Run:
    pipeline = {
        **{"name": "masks", "scene": "in_memory", "initializer": "sfm", "priors": PRIORS},
        **{"training": {"iterations": 24, "sh_degree": 0}, **parts},
    }
    return stereogs.train(pipeline, scene=scene(masked), progress=False)


def in_all_squares(points: PointCloud) -> int:
    """Number of points that each training view shows in the square: those of the object."""
    inside = torch.ones(len(points), dtype=torch.bool)
    for view in room().train:
        rows, columns = square(view.camera)
        u, v, _ = view.camera.project(points.positions)
        inside &= (v >= rows.start) & (v < rows.stop) & (u >= columns.start) & (u < columns.stop)
    return int(inside.sum())


@pytest.mark.parametrize("name", ["dense", "random"])
def test_what_only_excluded_pixels_show_is_not_in_the_render(name: str) -> None:
    samplers = ["independent_views", "resolution_schedule", "coarse_to_fine", "random_background"]
    terms = TERMS if name == "dense" else []
    run = trained(True, initializer=INITIALIZERS[name], regularizers=terms, samplers=samplers)
    assert max(amount(run.render(view.camera).rgb) for view in room().train) == 0
    run = trained(False, initializer=INITIALIZERS[name], samplers=samplers[1:2])
    assert min(amount(run.render(view.camera).rgb) for view in room().train) > 0.05


@pytest.mark.parametrize(
    ("exporter", "loader"), [(ColmapExporter, ColmapScene), (TransformsExporter, NerfstudioScene)]
)
def test_exported_photographs_keep_their_masks(exporter: Any, loader: Any, tmp_path: Path) -> None:
    masked = scene(True)
    file, *_ = build(exporter).export(model().model, masked, tmp_path)
    folder = tmp_path / file.relative_to(tmp_path).parts[0]
    for view, read in zip(masked.train, build(loader, path=folder).load().train, strict=True):
        assert view.weights is not None
        assert torch.equal(view.weights, read.weights)


@pytest.mark.parametrize("name", [name for name in INITIALIZERS if name != "random"])
def test_excluded_pixels_seed_no_point(name: str) -> None:
    counts = []
    for masked in (False, True):
        run = trained(masked, initializer=INITIALIZERS[name], training={"iterations": 1})
        means = run.model.read("means")
        counts.append(in_all_squares(PointCloud(means, means)))
    assert counts[1] == 0
    if name in ("dense", "flow"):
        assert counts[0] > 20


@pytest.mark.parametrize(
    ("term", "settings", "prior"),
    [
        (VirtualStereo, {"depth": "expected"}, None),
        (DistantL1, {"share": 1.0}, DepthCues),
        (PearsonDepth, {}, DepthCues),
        (DepthRanking, {}, DepthCues),
        (StereoDepth, {}, SgmPrior),
        (EmptyBackground, {"dark": 255}, None),
    ],
    ids=["virtual_stereo", "distant_l1", "pearson_depth", "depth_ranking", "stereo_depth", "empty"],
)
@pytest.mark.parametrize("masked", [False, True])
def test_terms_learn_nothing_in_excluded_pixels(
    term: Any, settings: dict[str, Any], prior: Any, masked: bool
) -> None:
    run = model()
    place = square(room().train[0].camera)
    train = (painted(room().train[0], masked), *room().train[1:])
    framed = replace(room(), train=train).in_frame(run.frame)
    seen = run.engine_model.render(framed.train[0].camera).detach()
    rgb, depth, alpha = leaves = [
        image.clone().requires_grad_() for image in (seen.rgb, seen.depth, seen.alpha)
    ]
    step = step_of(
        run.engine_model,
        framed,
        rendering=Rendering(rgb, depth, alpha),
        priors={} if prior is None else {"prior": build(prior)},
    )
    build(term, **settings).loss(step).backward()
    gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
    assert any(gradient.any() for gradient in gradients)
    excluded = [bool(gradient[place].any()) for gradient in gradients]
    assert any(excluded) != masked


@cache
def model() -> stereogs.Run:
    return trained(True, initializer=DENSE)
