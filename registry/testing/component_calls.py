"""Call a component of each kind as the host does, and check its answer."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest import mock
from uuid import uuid4

import torch
from torch import Tensor

from core_rasterizer import GaussianReader, Rendering
from core_rasterizer.layout import PARAMETER_GROUPS, PARAMETERS
from registry.toolkit.cache.entries import FOLDER_VARIABLE

from ..calls.repeats import digests
from ..confidence import Trained
from ..contract.checks.answers import check_moves
from ..contract.checks.scene import check_initialization
from ..contract.components import Observer, Unavailable
from ..contract.scene import View
from ..contract.step import Step
from ..errors import PluginError
from ..events import IterationDone, RunEnded, RunStarted, ViewsScored
from ..pipeline.training_settings import TrainingSettings
from ..priors import (
    GaussiansPrior,
    MaskPrior,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    NormalPrior,
    OpticalFlowPrior,
    PosedDepthPrior,
    StereoPrior,
)
from ..runs.options import RunOptions
from ..runs.training_run import start_run
from ..training.initial_model import initial_gaussians
from .assertions import require
from .bench import Bench
from .scenes import hook_point, pipeline_of

_SHORT = TrainingSettings(iterations=3, sh_degree=1)
_EVENTS = ("started", "iterated", "evaluated", "ended")


def _scene(bench: Bench, built: Any) -> Any:
    scene = bench.answer(built)
    return [(v.name, v.image, v.camera.world_to_camera) for v in (*scene.train, *scene.test)]


def _initializer(bench: Bench, built: Any) -> Any:
    given = bench.scene.for_training(), bench.priors
    points = bench.call(built.initialize, *given)
    if bench.size.degenerate and not len(points):
        return None  # the host reports it
    checked = check_initialization(points, *given)
    return initial_gaussians(checked, TrainingSettings(sh_degree=0))


def _prior(bench: Bench, built: Any) -> Any:
    capability = getattr(built, "capability", None)
    require(isinstance(capability, str), "a prior must have a class variable `capability`, a text")
    views = bench.scene.train
    images = [view.image for view in views]
    if isinstance(built, PosedDepthPrior):
        return _posed_depths(bench, built)
    answers = []
    for base, method, given in (
        (StereoPrior, "both", images),
        (MultiViewDepthPrior, "depths", [views, bench.scene.bounds]),
        (MonocularDepthPrior, "depth", images[:1]),
        (MonocularDepthPrior, "depth_of", [views[0], bench.scene.points]),
        (NormalPrior, "normals_of", views[:1]),
        (MaskPrior, "mask_of", views[:1]),
        (OpticalFlowPrior, "flow", images),
        (MatchingPrior, "matches", images),
        (GaussiansPrior, "gaussians", [views, bench.scene.bounds]),
    ):
        if isinstance(built, base):
            with mock.patch.dict(os.environ, {FOLDER_VARIABLE: ""}):  # no cache
                answers.append(bench.call(getattr(built, method), *given))
    if answers:
        return answers
    ask = bench.ask
    if ask is None:
        raise AssertionError(
            f"the prior's capability {capability!r} is its own, and the check does not know how to call it: "
            f"check({type(built).__name__}, call=...) with a function of the prior and a scene, for example "
            "call=lambda prior, scene: prior.normals(scene.train[0].image)"
        )
    return bench.call(ask, built, bench.scene)


def _posed_depths(bench: Bench, built: PosedDepthPrior[Any]) -> Any:
    """Ask for the least number of photographs and for one more, with known and unknown intrinsics."""
    least, most = built.accepted_views
    require(
        1 <= least <= (most or least),
        f"`accepted_views` is {least} to {most}: the least number of photographs must be 1 or more, and not "
        "above the largest",
    )
    views = (*bench.scene.train, *bench.scene.test)
    answers = []
    for count in range(least, min(least + 1, most or least + 1) + 1):
        chosen = [views[k % len(views)] for k in range(count)]
        known = [view.camera.intrinsics if k else None for k, view in enumerate(chosen)]
        with mock.patch.dict(os.environ, {FOLDER_VARIABLE: ""}):  # no cache
            answer = bench.call(built.posed_depths, [view.image for view in chosen], known)
        answers.append(answer)
    return answers


def _in_iteration(bench: Bench, built: Any) -> Any:
    return digests(bench.answer(built, bench.step(built)))


def _sampler(bench: Bench, built: Any) -> Any:
    step = bench.step(built)
    return digests(bench.answer(built, step, step.sample))


def _appearance(bench: Bench, built: Any) -> Any:
    step = bench.step(built)
    colors = bench.answer(built, step, step.rendering.rgb)
    require(colors.requires_grad, "the colours are cut off from autograd: nothing would be learnt")
    colors.mean().backward()
    return [colors, _gradients(step, built)]


def _regularizer(bench: Bench, built: Any) -> Any:
    step = bench.step(built)
    check_moves(built.moves, PARAMETER_GROUPS)
    loss = bench.answer(built, step)
    if loss.requires_grad:
        loss.backward()
    gradients = _gradients(step, built)
    if loss and not bench.size.degenerate:
        require(
            any(bool(gradient.any()) for gradient in gradients),
            f"the loss is {float(loss.detach()):g} and would change nothing: no gradient reaches the "
            "Gaussians or the component's own parameters; was it computed outside autograd?",
        )
    return [loss, gradients]


def _gradients(step: Step, built: Any) -> list[Tensor]:
    """Return the gradients of the Gaussians and of the component's own parameters; all finite."""
    own = [tensor.grad for group in built.parameters() for tensor in group.tensors]
    own += [feature.grad for feature in step.features.values()]
    gradients = [step.model.gradient(name) for name in PARAMETERS]
    gradients += [gradient for gradient in own if gradient is not None]
    for gradient in gradients:
        require(bool(torch.isfinite(gradient).all()), "a gradient of the answer is not finite")
    return gradients


def _metric(bench: Bench, built: Any) -> Any:
    first, second = bench.scene.train
    mask = torch.zeros(first.image.shape[:2], dtype=torch.bool)
    mask[: -(-len(mask) // 2)] = True
    cases = (
        (_render_of(first, 1.0), first),
        (_render_of(second, 1.5), first),
        (_render_of(second, 1.5), replace(first, mask=mask)),
    )
    scores = [bench.answer(built, *case, bench.scene) for case in cases]
    reasons = [score.reason for score in scores if isinstance(score, Unavailable)]
    numbers = [score for score in scores if not isinstance(score, Unavailable)]
    require(all(reasons), "a metric that is not available must say why")
    if bench.size.degenerate:
        return scores
    require(not (reasons and numbers), "the metric is available for some renders of a view only")
    if built.equal_images_are_best and numbers:
        equal, other, _ = numbers
        require(
            equal > other if built.higher_is_better else equal < other,
            "equal images must score better than different ones (`higher_is_better`); a metric that "
            "does not compare images sets equal_images_are_best = False",
        )
    return scores


def _render_of(view: View, depth_factor: float) -> Rendering:
    """Return a render that equals the photograph, with the true depth times a factor."""
    assert view.depth is not None
    return Rendering(view.image.clone(), depth_factor * view.depth, torch.ones_like(view.depth))


def _exporter(bench: Bench, built: Any) -> Any:
    with tempfile.TemporaryDirectory() as name:
        files = bench.answer(built, GaussianReader(bench.model()), bench.scene, Path(name))
        return [(file.name, file.read_bytes()) for file in sorted(files)]


def _report(bench: Bench, built: Any) -> Any:
    scene = replace(bench.scene, points=bench.points())
    if bench.size.hidden:
        scene = replace(scene, test=())
    options = RunOptions(scene=scene, device=bench.device, progress=False)
    with tempfile.TemporaryDirectory() as name:
        run = start_run(pipeline_of([], _SHORT), options, Path(name) / "run")
        files = bench.answer(built, run.folder_or_refuse().path, bench.scene)
        return [file.name for file in sorted(files)]


def _confidence(bench: Bench, built: Any) -> Any:
    def unknown(name: str) -> Any:
        raise PluginError(
            f"the check has no estimator {name!r}", fix="use the other attributes of `trained`"
        )

    scene, reader = bench.scene, GaussianReader(bench.model())
    trained = Trained(reader, scene.for_training(), bench.maps(), bench.kinds(), unknown)
    confidence, camera = bench.answer(built, trained), scene.test[0].camera
    values, gain = bench.call(confidence.of, camera), bench.call(confidence.gain, camera)
    require(
        values.shape == (camera.height, camera.width)
        and bool(((values >= 0) & (values <= 1)).all())
        and gain >= 0,
        "confidence must be [H, W] in [0, 1], and its gain at least 0",
    )
    return values, gain


def _observer(bench: Bench, built: Any) -> Any:
    """Send the events of a run, which fails if the scene is degenerate."""
    own = [name for name in _EVENTS if getattr(type(built), name) is not getattr(Observer, name)]
    require(bool(own), f"the observer handles no event: define one of {', '.join(_EVENTS)}")
    with tempfile.TemporaryDirectory() as folder:
        for method, event in zip(_EVENTS, _events(bench, Path(folder)), strict=True):
            bench.call(getattr(built, method), event)


def _events(bench: Bench, folder: Path) -> Iterator[Any]:
    """Yield an event for each method of `_EVENTS`."""
    step, succeeds = bench.after_backward(), not bench.size.degenerate
    yield RunStarted(
        title="a run",
        folder=folder,
        identity=uuid4().hex,
        iteration=0,
        resumed=False,
        iterations=step.iterations,
        pipeline=pipeline_of([], _SHORT).plain(),
        facts={"scene": {"name": bench.scene.name}, "seed": 0},
        scene=step.scene,
    )
    seen = step.rendering
    yield IterationDone(
        iteration=step.iteration,
        seconds=1.0,
        loss=0.5,
        numbers=MappingProxyType({"photometric": 0.5, "regularizers.one": float("inf")}),
        gaussians=step.model.count,
        learning_rates=step.learning_rates,
        view=step.view,
        target=step.sample.target,
        rendering=Rendering(seen.rgb.detach(), seen.depth.detach(), seen.alpha.detach()),
        model=step.model,
    )
    scores: dict[str, dict[str, float | None]] = {
        "test": {"one": 20.0, "other": None},
        "train": {"one": None, "other": None},
    }
    yield ViewsScored(step.iteration, scores, {k: {"a view": row} for k, row in scores.items()})
    results = {"hash": "0" * 64, **scores} if succeeds else None
    error = None if succeeds else "a loss is not finite"
    yield RunEnded(step.iteration, succeeds, results, error)


_CALLS: dict[str, Callable[[Bench, Any], Any]] = {
    "scene": _scene,
    "initializer": _initializer,
    "priors": _prior,
    "samplers": _sampler,
    "appearances": _appearance,
    "regularizers": _regularizer,
    "metrics": _metric,
    "exporters": _exporter,
    "reports": _report,
    "observers": _observer,
    "confidence": _confidence,
}
"""How to call a component, by section, where it receives more than the step, or more than its answer is
checked."""


def call_as_host(bench: Bench, built: Any) -> Any:
    """Call a built component as the host does; return what must be reproducible."""
    return _CALLS.get(hook_point(type(built)).section, _in_iteration)(bench, built)
