"""Each component alone, with its defaults, on plain 3DGS: a bare name must not spoil the result."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from torch.nn.functional import avg_pool2d

import stereogs
from registry import Scene, View
from tests.data import data_folder
from tests.host import GROUP, Offer, Plugins, default_schedule, evaluate, installed_entries

TOY_NORMALS = EntryPoint("toy_normals", "tests.stereogs_plugins.regularizers.toy_normals", GROUP)
"""A prior of normals; every shipped one needs a file."""
PLUGINS = Plugins([*installed_entries(), TOY_NORMALS])
OFFERS = [
    offer
    for offer in PLUGINS.all()
    if offer.distribution == "stereogs-plugins"
    and offer.point.scheduled
    and not offer.point.observes
]
ITERATIONS = 400
MOST = 1.0
"""Largest loss, dB of PSNR on photographs that were not trained on."""
BASE: dict[str, Any] = {
    "name": "plain",
    "initializer": "sfm",
    "densification": ["gradient_threshold"],
    "opacity": ["opacity_reset"],
    "metrics": ["psnr"],
    "training": {"iterations": ITERATIONS, "sh_degree": 1, "sh_every": 200},
}
DENSE = {"priors": ["plane_sweep"], "initializer": {"use": "consistency_dense", "stride": 3}}
MAPS = DENSE | {"initializer": {"use": "consistency_dense", "stride": 3, "hand_on_depth": True}}
MONOCULAR = {
    "use": "onnx_mono",
    "model": "${STEREOGS_MODELS}/fastdepth_nyu/fastdepth_nyu.onnx",
    "family": "dpt",
    "short_side": 224,
}
TWO_FIELDS = {"training": BASE["training"] | {"fields": 2}}
NEEDS: dict[str, dict[str, Any]] = {
    "stereo_depth": {"priors": ["sgm"]},
    "depth_ranking": {"priors": ["plane_sweep"]},
    "patch_depth": {"priors": ["plane_sweep"]},
    "depth_from_initializer": MAPS,
    "forward_warping": MAPS,
    "pearson_depth": {"priors": [MONOCULAR]},
    "distant_l1": {"priors": [MONOCULAR]},
    "prior_normals": {"priors": ["toy_normals"]},
    "field_agreement": TWO_FIELDS,
    "co_pruning": TWO_FIELDS,
}
"""Sections that a component cannot do without; the pipeline that it is compared with has them too."""
SETTINGS: dict[str, dict[str, Any]] = {
    "parameter_l1": {"parameter": "opacities"},
    "patch_depth": {"form": "hard"},
    "expected_opacity": {"rate": 0.2},
    "co_pruning": {"distance": 5.0},
}
"""Settings without a default, as published for LLFF."""


def label(offer: Offer) -> str:
    return f"{offer.point.section}.{offer.name}"


@cache
def fern(folder: Path) -> Scene:
    """Three training views at half size; tested on four photographs between them, none a test view."""
    source = {"use": "llff", "path": str(folder)}
    three = stereogs.load_scene(
        {"scene": source | {"train_views": 3}, "initializer": "sfm", "name": "f"}
    )
    every = stereogs.load_scene(
        {"scene": source | {"train_views": 17}, "initializer": "sfm", "name": "f"}
    )
    used = {view.name for view in three.train}
    others = [view for view in every.train if view.name not in used]
    return replace(
        three, train=tuple(map(_halved, three.train)), test=tuple(map(_halved, others[1::4]))
    )


def _halved(view: View) -> View:
    height, width = view.image.shape[:2]
    image = avg_pool2d(view.image.permute(2, 0, 1), 2).permute(1, 2, 0).contiguous()
    return View(view.name, view.camera.resized(width // 2, height // 2), image)


def psnr(scene: Scene, values: dict[str, Any]) -> float:
    pipeline = stereogs.build_pipeline(values, plugins=PLUGINS)
    run = stereogs.train(pipeline, scene=scene, progress=False)
    mean = evaluate(run.engine_model, run.framed, run.framed.test, run.parts["metrics"]).mean
    value = mean["psnr"]
    assert value is not None
    return value


@cache
def without(folder: Path, needs: str) -> float:
    return psnr(fern(folder), BASE | NEEDS.get(needs, {}))


def lost(folder: Path, offer: Offer) -> float:
    """How much PSNR a component costs."""
    section, values = offer.point.section, BASE | NEEDS.get(offer.name, {})
    replaced = offer.component.ablation_baseline
    kept = [name for name in values.get(section, []) if name not in (replaced, offer.name)]
    values[section] = [*kept, {"use": offer.name, **SETTINGS.get(offer.name, {})}]
    same = [name for name in NEEDS if NEEDS[name] is NEEDS.get(offer.name)]
    return without(folder, same[0] if same else "") - psnr(fern(folder), values)


def check(offer: Offer) -> None:
    loss = lost(data_folder("llff_fern"), offer)
    print(f"{label(offer)}: {-loss:+.2f} dB")
    assert loss <= MOST, f"{label(offer)} costs {loss:.2f} dB; are its `host_defaults` right?"


@pytest.mark.parametrize("iterations", [1, 30, 400, 30_000])
def test_default_schedules_fit_every_length(iterations: int) -> None:
    for offer in OFFERS:
        calls = len(default_schedule(offer, iterations).due_in(iterations))
        assert calls or iterations < 400, f"{label(offer)} is never due"


@pytest.mark.proof
@pytest.mark.parametrize("offer", OFFERS, ids=label)
def test_a_bare_name_does_not_spoil_plain_3dgs(offer: Offer) -> None:
    """A trap when every component was called in each iteration by default."""
    check(offer)
