"""What the host would ask of a component of each kind, and checks of the answers."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from core_rasterizer.layout import PARAMETER_GROUPS, PARAMETERS

from ..contract.checks.answers import (
    check_colors,
    check_edit,
    check_loss,
    check_moves,
    check_offsets,
    check_opacity_scale,
    check_opacity_update,
    check_sample,
    check_score,
)
from ..contract.checks.scene import validate
from ..contract.components import Unavailable
from ..pipeline.training_settings import TrainingSettings
from ..priors import (
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    StereoPrior,
)
from ..toolkit.cache import FOLDER_VARIABLE
from ..training.initial_model import initial_gaussians
from .bench import Bench, Moment
from .judging import require, require_files
from .listening import ask_observer
from .run_folder import finished_run
from .scenes import pictured


def _ask_scene(bench: Bench, built: Any) -> Any:
    scene = validate(bench.ask(built.load))
    return [(v.name, v.image, v.camera.world_to_camera) for v in (*scene.train, *scene.test)]


def _ask_initializer(bench: Bench, built: Any) -> Any:
    points = bench.ask(built.initialize, bench.scene.for_training(), bench.priors)
    if not bench.size.rich and not len(points):
        return None  # as good as an error: the host says it in words
    gaussians = initial_gaussians(points, TrainingSettings(sh_degree=0))
    return [gaussians.means, gaussians.log_scales, gaussians.opacity_logits, gaussians.sh]


def _ask_prior(bench: Bench, built: Any) -> Any:
    capability = getattr(built, "capability", None)
    require(isinstance(capability, str), "a prior must have a class variable `capability`, a text")
    first, second = bench.scene.train
    with _without_cache():
        if isinstance(built, StereoPrior):
            answers = bench.ask(built.both, first.image, second.image)
            return [tensor for a in answers for tensor in (a.values, a.valid)]
        if isinstance(built, MultiViewDepthPrior):
            maps = bench.ask(built.depths, (first, second), bench.scene.bounds)
            return [tensor for m in maps for tensor in (m.depth, m.valid, m.confidence)]
        if isinstance(built, MonocularDepthPrior):
            return bench.ask(built.inverse_depth, first.image)
        if isinstance(built, OpticalFlowPrior):
            return list(vars(bench.ask(built.flow, first.image, second.image)).values())
        if isinstance(built, MatchingPrior):
            return list(vars(bench.ask(built.matches, first.image, second.image)).values())
    return capability


@contextmanager
def _without_cache() -> Iterator[None]:
    """Have priors answer for themselves."""
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = ""
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before


def _ask_sampler(bench: Bench, built: Any) -> Any:
    moment = bench.begun()
    step = moment.step
    sample = check_sample(bench.ask(built.sample, step, step.sample), moment.model.count)
    return [sample.view.name, sample.target, sample.background, sample.sh_degree, sample.smoothing]


def _ask_appearance(bench: Bench, built: Any) -> Any:
    moment = bench.rendered()
    rgb = moment.step.rendering.rgb
    colors = check_colors(bench.ask(built.colors, moment.step, rgb), rgb.shape)
    require(colors.requires_grad, "the colours are cut off from autograd: nothing would be learnt")
    colors.mean().backward()
    return [colors.detach(), _gradients(moment, built)]


def _ask_regularizer(bench: Bench, built: Any) -> Any:
    moment = bench.rendered()
    check_moves(built.moves, PARAMETER_GROUPS)
    loss = check_loss(bench.ask(built.loss, moment.step))
    if loss.requires_grad:
        loss.backward()
    gradients = _gradients(moment, built)
    reached = any(bool(gradient.any()) for gradient in gradients)
    if loss and bench.size.rich:
        require(
            reached,
            f"the loss is {float(loss.detach()):g} and changes nothing: no gradient reaches the Gaussians or "
            "the component's own parameters; was it computed outside autograd?",
        )
    return [loss.detach(), gradients]


def _ask_modifier(bench: Bench, built: Any) -> Any:
    moment = bench.begun()
    return check_opacity_scale(
        bench.ask(built.opacity_scale, moment.step), moment.model.count
    ).clone()


def _ask_densification(bench: Bench, built: Any) -> Any:
    moment = bench.differentiated(absolute=built.absolute_gradients)
    edit = check_edit(bench.ask(built.refine, moment.step), moment.model.count)
    if edit is None:
        return None
    added = None if edit.add is None else dict(vars(edit.add))
    moved = None if edit.relocate is None else [edit.relocate.source, edit.relocate.target]
    return [edit.clone, edit.split, edit.prune, edit.split_into, edit.shrink, added, moved]


def _ask_opacity(bench: Bench, built: Any) -> Any:
    moment = bench.differentiated()
    update = check_opacity_update(bench.ask(built.update, moment.step), moment.model.count)
    return None if update is None else [update.opacities.clone(), update.reset_moments]


def _ask_perturbation(bench: Bench, built: Any) -> Any:
    moment = bench.differentiated()
    return dict(check_offsets(bench.ask(built.offsets, moment.step), moment.model.read))


def _gradients(moment: Moment, built: Any) -> list[Tensor]:
    """Of the Gaussians, and of the component's own parameters; finite."""
    own = [tensor.grad for group in built.parameters() for tensor in group.tensors]
    gradients = [moment.model.gradient(name).clone() for name in PARAMETERS]
    gradients += [gradient for gradient in own if gradient is not None]
    for gradient in gradients:
        require(bool(torch.isfinite(gradient).all()), "a gradient of the answer is not finite")
    return gradients


def _ask_metric(bench: Bench, built: Any) -> Any:
    first, second = bench.scene.train
    mask = torch.zeros(first.image.shape[:2], dtype=torch.bool)
    mask[: -(-len(mask) // 2)] = True
    looks = (
        (pictured(first, 1.0), first),
        (pictured(second, 1.5), first),
        (pictured(second, 1.5), replace(first, mask=mask)),
    )
    scores = [
        check_score(bench.ask(built.measure_view, rendering, view, bench.scene))
        for rendering, view in looks
    ]
    reasons = [score.reason for score in scores if isinstance(score, Unavailable)]
    numbers = [score for score in scores if not isinstance(score, Unavailable)]
    require(all(reasons), "a metric that is not available must say why")
    if not bench.size.rich:
        return scores
    require(not (reasons and numbers), "the metric is available for some renders of a view only")
    if built.equal_images_are_best and numbers:
        equal, other, _ = numbers
        better = equal > other if built.higher_is_better else equal < other
        require(
            better,
            "equal images must score better than different ones (`higher_is_better`), or the class "
            "say that it looks at something else: equal_images_are_best = False",
        )
    return scores


def _ask_exporter(bench: Bench, built: Any) -> Any:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = bench.ask(built.export, bench.model().reader(), bench.scene, folder)
        require_files(files)
        return [(file.name, file.read_bytes()) for file in sorted(files)]


def _ask_report(bench: Bench, built: Any) -> Any:
    with finished_run(bench) as folder:
        files = bench.ask(built.write, folder, bench.scene)
        require_files(files)
        return [file.name for file in sorted(files)]


ASK: dict[str, Callable[[Bench, Any], Any]] = {
    "scene": _ask_scene,
    "initializer": _ask_initializer,
    "priors": _ask_prior,
    "samplers": _ask_sampler,
    "appearances": _ask_appearance,
    "regularizers": _ask_regularizer,
    "modifiers": _ask_modifier,
    "densification": _ask_densification,
    "opacity": _ask_opacity,
    "perturbations": _ask_perturbation,
    "metrics": _ask_metric,
    "exporters": _ask_exporter,
    "reports": _ask_report,
    "observers": ask_observer,
}
"""What the host would ask, by the section of the pipeline; each answers with what must repeat."""
