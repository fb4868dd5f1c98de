"""A conformance suite: what a plugin author runs on a component of their own.

    from registry.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

It builds the component on a tiny scene, asks it what the host would ask, and holds the answers to the
contract: shapes, types, finite values, gradients, and the same answer for the same seed. What a
component is *good* for, its author must test.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import (
    Camera,
    Device,
    GaussianModel,
    Gaussians,
    Rendering,
    open_device,
    photometric_loss,
)

from .contract.answers import (
    check_edit,
    check_loss,
    check_opacity_scale,
    check_opacity_update,
    check_score,
)
from .contract.component import Component, Context, Settings
from .contract.components import Unavailable
from .contract.hook_points import HOOK_POINTS
from .contract.prior import Prior
from .contract.scene import PointCloud, Scene, View, validate
from .contract.step import Step
from .pipeline.training_settings import TrainingSettings
from .plugins import check_offer
from .priors.capabilities import MonocularDepthPrior, MultiViewDepthPrior, StereoPrior
from .priors.prior_cache import VARIABLE
from .training.initial_model import initial_gaussians
from .training.step_rendering import StepRenderer

_WIDTH, _HEIGHT = 32, 24


def check(
    component: type[Component[Any]],
    *,
    priors: dict[str, Prior[Any]] | None = None,
    device: Device | None = None,
    **settings: Any,
) -> None:
    """Try one component class; a fault raises with a message that says which.

    Args:
        priors: what `Step.priors` and `initialize` are given.
        device: where the Gaussians live; None chooses.
        settings: for the component, as Python values.

    Raises:
        AssertionError: the component breaks the contract.
        ExplainedError: the host or the engine would refuse the class or an answer.
    """
    point = next((p for p in HOOK_POINTS if issubclass(component, p.base)), None)
    _require(point is not None, f"{component.__name__} derives from none of the component bases")
    assert point is not None
    check_offer(point, "conformance", component)
    chosen = component.Settings(**settings)
    _check_settings(chosen)
    bench = Bench(device or open_device(), priors or {})
    answers = []
    for _ in range(2):
        built = component(chosen, Context("conformance", 7, bench.device))
        answers.append(_ASK[point.section](bench, built))
        _check_state(component, chosen, built, bench)
    _require(
        _same(*answers), f"two {point.title}s with one seed gave different answers to one question"
    )


@dataclass
class Bench:
    """A tiny scene and Gaussians that look at it, made anew for every question."""

    device: Device
    priors: dict[str, Prior[Any]]

    @property
    def scene(self) -> Scene:
        """Three views of smooth colours, two to train and one to test, with 60 points."""
        return tiny_scene()

    def step(self) -> Step:
        """An iteration's view of things before its render."""
        scene = self.scene
        assert scene.points is not None
        gaussians: Gaussians = initial_gaussians(scene.points, TrainingSettings(sh_degree=1))
        model = GaussianModel(gaussians, self.device)
        return Step(
            iteration=10,
            iterations=100,
            scene=scene,
            view=scene.train[0],
            rendering=None,
            model=model,
            extent=scene.extent,
            priors=self.priors,
            render=StepRenderer(model, scene, 1),
            log=_log,
        )

    def rendered(self) -> Step:
        """An iteration's view of things after its render."""
        step = self.step()
        step.rendering = step.model.render(step.view.camera, collect_statistics=True)
        return step

    def differentiated(self) -> Step:
        """An iteration's view of things after its backward pass."""
        step = self.rendered()
        assert step.rendering is not None
        loss = photometric_loss(step.rendering.rgb, step.view.image, device=step.model.device)
        loss.backward()
        return step


def tiny_scene() -> Scene:
    """Three cameras side by side that look at points between z = 2 and 4, and a wall at 3; 32x24."""
    generator = torch.Generator().manual_seed(1)
    rows = torch.linspace(0, 1, _HEIGHT)[:, None].expand(_HEIGHT, _WIDTH)
    columns = torch.linspace(0, 1, _WIDTH)[None].expand(_HEIGHT, _WIDTH)
    views = []
    for index in range(3):
        pose = torch.eye(4)
        pose[0, 3] = 0.2 * (1 - index)
        image = torch.stack([rows, columns, torch.full_like(rows, 0.2 + 0.3 * index)], dim=2)
        camera = Camera(pose, 30.0, 30.0, _WIDTH / 2, _HEIGHT / 2, _WIDTH, _HEIGHT)
        views.append(View(f"view{index}", camera, image, depth=torch.full_like(rows, 3.0)))
    positions = torch.rand(60, 3, generator=generator) * 2 - 1
    positions[:, 2] += 3
    points = PointCloud(positions, torch.rand(60, 3, generator=generator))
    return validate(
        Scene("tiny", (views[0], views[2]), (views[1],), bounds=(1.5, 5.0), points=points)
    )


def _check_settings(settings: Settings) -> None:
    again = type(settings).model_validate_json(
        json.dumps(settings.model_dump(mode="json")), strict=True
    )
    _require(again == settings, "the settings do not survive being written to a pipeline file")


def _check_state(
    component: type[Component[Any]], settings: Settings, built: Component[Any], bench: Bench
) -> None:
    """Saved and restored state must be equal; carrying must be possible."""
    count = bench.step().model.count
    source = torch.arange(1, count)
    built.carry(source, torch.zeros(len(source), dtype=torch.bool))
    state = built.state()
    for name, value in state.items():
        _require(isinstance(value, Tensor), f"state()[{name!r}] is not a tensor")
    other = component(settings, Context("conformance", 7, bench.device))
    other.restore({name: value.clone() for name, value in state.items()})
    _require(_same(other.state(), state), "restore() does not bring back what state() returned")


def _ask_scene(bench: Bench, built: Any) -> Any:
    scene = validate(built.load())
    return [(v.name, v.image, v.camera.world_to_camera) for v in (*scene.train, *scene.test)]


def _ask_initializer(bench: Bench, built: Any) -> Any:
    gaussians = initial_gaussians(
        built.initialize(bench.scene, bench.priors), TrainingSettings(sh_degree=0)
    )
    return [gaussians.means, gaussians.log_scales, gaussians.opacity_logits, gaussians.sh]


def _ask_prior(bench: Bench, built: Any) -> Any:
    capability = getattr(built, "capability", None)
    _require(isinstance(capability, str), "a prior must have a class variable `capability`, a text")
    first, second = bench.scene.train
    with _without_cache():
        if isinstance(built, StereoPrior):
            answers = built.both(first.image, second.image)
            return [tensor for a in answers for tensor in (a.values, a.valid)]
        if isinstance(built, MultiViewDepthPrior):
            maps = built.depths((first, second), bench.scene.bounds)
            return [tensor for m in maps for tensor in (m.depth, m.valid, m.confidence)]
        if isinstance(built, MonocularDepthPrior):
            return built.inverse_depth(first.image)
    return capability


@contextmanager
def _without_cache() -> Iterator[None]:
    """Have priors answer for themselves."""
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = ""
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


def _ask_regularizer(bench: Bench, built: Any) -> Any:
    step = bench.rendered()
    before = step.model.digest()
    loss = check_loss(built.loss(step))
    if loss.requires_grad:
        loss.backward()
    gradients = [step.model.gradient(name).clone() for name in ("means", "opacity_logits", "sh")]
    _require(step.model.digest() == before, "the regularizer changed the Gaussians")
    return [loss.detach(), *gradients]


def _ask_modifier(bench: Bench, built: Any) -> Any:
    step = bench.step()
    return check_opacity_scale(built.opacity_scale(step), step.model.count).clone()


def _ask_densification(bench: Bench, built: Any) -> Any:
    step = bench.differentiated()
    before = step.model.digest()
    edit = check_edit(built.refine(step), step.model.count)
    _require(step.model.digest() == before, "the policy changed the Gaussians itself")
    return None if edit is None else [edit.clone, edit.split, edit.prune]


def _ask_opacity(bench: Bench, built: Any) -> Any:
    step = bench.differentiated()
    before = step.model.digest()
    update = check_opacity_update(built.update(step), step.model.count)
    _require(step.model.digest() == before, "the policy changed the Gaussians itself")
    return None if update is None else [update.opacities.clone(), update.reset_moments]


def _ask_metric(bench: Bench, built: Any) -> Any:
    scene = bench.scene
    first, second = scene.train
    equal, other = (
        check_score(built.measure_view(rendering, first, scene))
        for rendering in (_pictured(first, 1.0), _pictured(second, 1.5))
    )
    mask = torch.zeros(_HEIGHT, _WIDTH, dtype=torch.bool)
    mask[4:20, 4:28] = True
    masked = check_score(
        built.measure_view(_pictured(second, 1.5), replace(first, mask=mask), scene)
    )
    if isinstance(equal, Unavailable) or isinstance(other, Unavailable):
        answers = (equal, other, masked)
        reasons = [answer.reason for answer in answers if isinstance(answer, Unavailable)]
        _require(len(reasons) == 3, "the metric is available for some renders of a view only")
        _require(all(reasons), "a metric that is not available must say why")
        return reasons
    better = equal > other if built.higher_is_better else equal < other
    _require(better, "equal images must score better than different ones (`higher_is_better`)")
    return [other, masked]


def _pictured(view: View, depth_factor: float) -> Rendering:
    """A render that shows the view's photograph, and its true depth times a factor."""
    assert view.depth is not None
    return Rendering(view.image, depth_factor * view.depth, torch.ones(_HEIGHT, _WIDTH))


def _ask_exporter(bench: Bench, built: Any) -> Any:
    step = bench.step()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = built.export(step.model, step.scene, folder)
        _check_files(files)
        return [(file.name, file.read_bytes()) for file in sorted(files)]


def _ask_report(bench: Bench, built: Any) -> Any:
    results = {
        "pipeline": "tiny",
        "scene": {"name": "tiny"},
        "test": {"score": 20.0},
        "train": {"score": 30.0},
        "views": {"test": {"view1": {"score": 20.0}}, "train": {}},
        "unavailable": {},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "renders").mkdir()
        (folder / "results.json").write_text(json.dumps(results), "utf-8")
        files = built.write(folder, bench.scene)
        _check_files(files)
        return [file.name for file in sorted(files)]


_ASK: dict[str, Callable[[Bench, Any], Any]] = {
    "scene": _ask_scene,
    "initializer": _ask_initializer,
    "priors": _ask_prior,
    "regularizers": _ask_regularizer,
    "modifiers": _ask_modifier,
    "densification": _ask_densification,
    "opacity": _ask_opacity,
    "metrics": _ask_metric,
    "exporters": _ask_exporter,
    "reports": _ask_report,
}


def _check_files(files: Any) -> None:
    _require(isinstance(files, list), "the answer is not a list of the files written")
    for file in files:
        _require(Path(file).is_file(), f"the file {file} was not written")


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, Tensor) and isinstance(second, Tensor):
        return torch.equal(first, second)
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(_same(first[k], second[k]) for k in first)
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(map(_same, first, second))
    return bool(first == second)


def _log(name: str, value: float) -> None:
    _require(isinstance(name, str), "step.log takes a name and a number")
    float(value)


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise AssertionError(message)
