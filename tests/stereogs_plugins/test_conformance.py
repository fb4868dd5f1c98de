"""Every shipped component keeps the contract, and none is left out."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import torch

from core_rasterizer import Gaussians, save_ply
from registry import Prior, TrainingView
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.testing import check, tiny_scene
from tests.core_rasterizer.quick_device import quick_device
from tests.host import GROUP, Offer, Plugins
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.metrics.lpips_network import onnx_difference, sha256
from tests.stereogs_plugins.priors import graphs, modules
from tests.stereogs_plugins.regularizers.stereo_depth.block_matching import BlockMatcher
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    World,
    write_blender,
    write_colmap,
    write_dtu,
    write_llff,
    write_nerfstudio,
)

Settings = dict[str, Any]
Write = Callable[[Path], Settings]
"""Writes the files that a component needs into a folder, and returns settings that name them."""


def mono_of(family: str) -> Write:
    """The settings of a monocular network of a family."""
    return lambda folder: {
        "model": graphs.mono(folder / "m.onnx"),
        "family": family,
        "short_side": 56,
    }


class Wall(MultiViewDepthPrior):
    """The depth of the tiny scene's wall everywhere."""

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return it for each view."""
        known = [torch.ones(view.image.shape[:2], dtype=torch.bool) for view in views]
        return [DepthMap(3.0 * mask, mask, mask.float()) for mask in known]


def needs_nothing(folder: Path) -> Settings:
    return {}


def few_planes(folder: Path) -> Settings:
    return {"planes": 12}


def scene(write: Callable[[Path, World], Path], world: World, **settings: Any) -> Write:
    return lambda folder: {"path": write(folder, world), **settings}


def network(folder: Path) -> Settings:
    file = onnx_difference(folder / "whole.onnx")
    return {"network": "alex", "file": file, "sha256": sha256(file)}


def gaussians(folder: Path) -> Settings:
    points = tiny_scene().points
    assert points is not None
    size = torch.full((len(points),), 0.1)
    save_ply(
        Gaussians.from_points(points.positions, points.colors, size, size, 0), folder / "g.ply"
    )
    return {"path": folder / "g.ply"}


def complete(folder: Path) -> Settings:
    return {"fill": True, "back_layer": True, "margin": True, "merge": True, "stride": 2}


SHIPPED: dict[str, tuple[Write, ...]] = {
    "scene.llff": (scene(write_llff, World(), downsample=2),),
    "scene.blender": (scene(write_blender, World(), train_ids=(1, 3, 5)),),
    "scene.dtu": (scene(write_dtu, World(count=DTU_VIEWS, shift=(3.0, -2.0))),),
    "scene.colmap": (scene(write_colmap, World(shift=(3.0, -2.0))),),
    "scene.nerfstudio": (scene(write_nerfstudio, World(shift=(3.0, -2.0))),),
    "scene.procedural": (lambda folder: {"width": 32, "height": 24},),
    "initializer.sfm": (needs_nothing,),
    "initializer.random": (lambda folder: {"count": 100},),
    "initializer.ply": (gaussians,),
    "initializer.consistency_dense": (needs_nothing, complete),
    "priors.depth_cues": (needs_nothing,),
    "priors.patch_match": (needs_nothing,),
    "priors.plane_sweep": (few_planes,),
    "priors.sgm": (
        needs_nothing,
        lambda folder: {
            "cost": "features",
            "features": graphs.grey_features(folder / "m.onnx"),
            "max_disparity": 10,
        },
    ),
    "priors.torch_module": (
        lambda folder: {"model": modules.saved(folder / "m.pt", modules.Mean())},
    ),
    "priors.onnx_mvs": (lambda folder: {"model": graphs.pick(folder / "m.onnx", "K", (0, 0, 0))},),
    "priors.onnx_stereo": (lambda folder: {"model": graphs.matcher(folder / "m.onnx")},),
    "priors.onnx_mono": tuple(map(mono_of, ("depth_anything_v2", "dpt"))),
    "regularizers.stereo_depth": (
        needs_nothing,
        lambda folder: {"refresh_threshold": 0.0, "tau": 1.0},
    ),
    "modifiers.dropout": (needs_nothing,),
    "densification.gradient_threshold": (needs_nothing,),
    "opacity.opacity_reset": (needs_nothing,),
    "opacity.constant_decay": (needs_nothing,),
    "opacity.gradient_aware_decay": (
        lambda folder: {"scope": "all"},
        lambda folder: {"scope": "contributing"},
    ),
    "metrics.psnr": (lambda folder: {"quantize": "png8"},),
    "metrics.ssim": (lambda folder: {"quantize": "png8"},),
    "metrics.ssim_skimage": (lambda folder: {"quantize": "png8"},),
    "metrics.lpips": (needs_nothing, network),
    "metrics.lpips_proper": (network,),
    "metrics.depth_error": (needs_nothing, lambda folder: {"against": "points"}),
    "metrics.psnr_seen": (needs_nothing,),
    "metrics.psnr_unseen": (needs_nothing,),
    "metrics.seen": (needs_nothing,),
    "metrics.psnr_predicted": (needs_nothing,),
    "metrics.view_angle": (needs_nothing,),
    "metrics.depth_within": (
        lambda folder: {"percent": 40.0},
        lambda folder: {"percent": 40.0, "against": "points"},
    ),
    "exporters.ply": (needs_nothing,),
    "exporters.cameras": (needs_nothing,),
    "exporters.gltf": (needs_nothing,),
    "exporters.colmap": (lambda folder: {"text": True},),
    "exporters.spz": (needs_nothing,),
    "exporters.transforms": (needs_nothing,),
    "reports.html": (needs_nothing,),
}
BY_THEMSELVES: dict[str, tuple[Settings, ...]] = {
    "appearances.exposure": ({},),
    "densification.co_pruning": ({"distance": 0.1},),
    "densification.faint_growth": ({"share": 0.5},),
    "densification.proximity_unpooling": (
        {},
        {"size": 0.02, "distance": 0.06, "split_distance": 0.1},
    ),
    "densification.relocation": (
        {},
        {"dead_opacity": 0.5},
    ),
    "densification.unseen_pruning": ({},),
    "exporters.video": ({"frames": 2},),
    "modifiers.depth_density_dropout": ({"last_rate": 0.9},),
    "modifiers.opacity_noise": ({},),
    "opacity.expected_opacity": ({"rate": 0.2},),
    "perturbations.held_colors": ({},),
    "perturbations.position_noise": ({},),
    "perturbations.size_limit": ({},),
    "regularizers.cycle_filtered_warping": ({},),
    "regularizers.depth_smoothness": (
        {},
        {"views": "sphere", "by_alpha": True, "first_factor": 4000},
    ),
    "regularizers.empty_background": (
        {},
        {"squared": True, "dark": 30},
    ),
    "regularizers.forward_warping": (
        {},
        {"views": "between", "ssim_weight": 0.2},
    ),
    "regularizers.gaussian_shape": ({},),
    "regularizers.near_occlusion": (
        {},
        {"share": 1.0},
    ),
    "regularizers.virtual_stereo": ({},),
    "samplers.camera_refinement": ({},),
    "samplers.coarse_to_fine": ({},),
    "samplers.independent_views": ({},),
    "samplers.random_background": ({},),
    "samplers.resolution_schedule": ({},),
}
"""Settings of components that need no files and no priors."""
ELSEWHERE = {
    "initializer.flow_epipolar": "initializers/two_view/test_flow_epipolar.py",
    "initializer.feed_forward": "initializers/test_feed_forward.py",
    "initializer.matched_points": "initializers/two_view/test_matched_points.py",
    "observers.mlflow": "observers/test_mlflow.py",
    "observers.rerun": "observers/test_rerun.py",
    "observers.tensorboard": "observers/test_tensorboard.py",
    "observers.wandb": "observers/test_wandb.py",
    "priors.dis_flow": "priors/test_dis_flow.py",
    "priors.onnx_flow": "priors/test_onnx_flow.py",
    "priors.onnx_moge": "priors/test_onnx_moge.py",
    "priors.onnx_gaussians": "priors/feed_forward/test_onnx_gaussians.py",
    "priors.onnx_posed": "priors/feed_forward/test_onnx_posed.py",
    "priors.onnx_matching": "priors/test_onnx_matching.py",
    "priors.sift_matches": "priors/test_sift_matches.py",
    "regularizers.depth_from_initializer": "regularizers/known_depth/test_depth_from_initializer.py",
    "regularizers.depth_ranking": "regularizers/known_depth/test_depth_ranking.py",
    "regularizers.distant_l1": "regularizers/test_distant_l1.py",
    "regularizers.field_agreement": "regularizers/unseen_views/test_field_agreement.py",
    "regularizers.normal_consistency": "regularizers/test_normal_consistency.py",
    "regularizers.prior_normals": "regularizers/test_normal_consistency.py",
    "regularizers.parameter_l1": "regularizers/test_parameter_l1.py",
    "regularizers.patch_depth": "regularizers/known_depth/test_patch_depth.py",
    "regularizers.pearson_depth": "regularizers/test_pearson_depth.py",
    "scene.photos": "scenes/photos/test_loader.py",
    "scene.video": "scenes/photos/test_video_file.py",
}
"""Tried beside what they need, in files of their own."""
BY_ANOTHER_PROGRAM = ("exporters.html", "exporters.sog")
"""What that program writes differs from call to call; see exporters/test_splat_transform.py."""


@cache
def shipped() -> dict[str, Offer]:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))
    entries = project["project"]["entry-points"][GROUP]
    plugins = Plugins([EntryPoint(name, module, GROUP) for name, module in entries.items()])
    offers = (offer for offer in plugins.all() if offer.point.in_pipeline)
    return {f"{offer.point.section}.{offer.name}": offer for offer in offers}


def test_none_is_left_out() -> None:
    offers = shipped()
    assert sorted([*SHIPPED, *BY_THEMSELVES, *ELSEWHERE, *BY_ANOTHER_PROGRAM]) == sorted(offers)
    for name, file in ELSEWHERE.items():
        tests = (Path(__file__).parent / file).read_text("utf-8")
        assert re.search(rf"check\({offers[name].component.__name__}[,)]", tests), name


@pytest.mark.parametrize(
    ("name", "write"), [(name, write) for name, writes in SHIPPED.items() for write in writes]
)
def test_it_keeps_the_contract(name: str, write: Write, tmp_path: Path) -> None:
    priors: dict[str, Prior[Any]] = {"matcher": build(BlockMatcher), "wall": build(Wall)}
    check(shipped()[name].component, priors=priors, device=quick_device(), **write(tmp_path))


@pytest.mark.parametrize(
    ("name", "settings"), [(name, given) for name, each in BY_THEMSELVES.items() for given in each]
)
def test_it_keeps_the_contract_by_itself(name: str, settings: Settings) -> None:
    check(shipped()[name].component, device=quick_device(), **settings)
