"""Find the prior and settings for an ONNX file by trying them on a scene with known depth.

Priors that run ONNX files suggest settings (`RunsOnnxFiles`); those with the smallest error are the best.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from core_rasterizer import Camera
from registry import PluginError, Prior, TrainingView
from registry.calls.blame import blame as blamed
from registry.contract.hook_points import HOOK_POINTS
from registry.discovery import Offer, Plugins
from registry.pipeline.edits import apply_override
from registry.pipeline.parts import build_part
from registry.pipeline.pipeline import component_item
from registry.pipeline.settings_check import escape_variables, plain
from registry.pipeline.yaml_source import parse, to_yaml
from registry.priors import (
    GaussiansPrior,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    PosedDepth,
    PosedDepthPrior,
    StereoPrior,
)

from ...scene_source import find_loader

if TYPE_CHECKING:
    from core_rasterizer import Device
    from registry.toolkit.networks import OnnxModel

_PRIORS = next(point for point in HOOK_POINTS if point.section == "priors")
PIXELS = 2.0
"""Largest error of a correct disparity, flow vector or match."""
RELATIVE_DEPTH = 0.03
"""Largest relative error of a correct depth."""
_SAME_SURFACE = 0.02
"""Largest relative depth difference between two views of the same surface point."""


@runtime_checkable
class RunsOnnxFiles(Protocol):
    """What `stereogs priors check` asks of a prior; others have no `settings_for` and are not tried."""

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """Return candidate settings for an ONNX file, the likeliest first; none if the prior cannot run it.

        Each includes the file and consists of plain values. Options that the graph's names and sizes do not
        determine, such as the values of black and white, need a candidate for each possibility.
        """


@runtime_checkable
class RunsTorchScript(Protocol):
    """The same for files of TorchScript, of which only the path is known."""

    @classmethod
    def settings_for_script(cls, path: Path) -> Sequence[Mapping[str, Any]]:
        """Return candidate settings for a file, the likeliest first; none if the prior cannot run it."""


@dataclass(frozen=True)
class Guess:
    """A prior with settings to try, as plain values."""

    offer: Offer
    settings: dict[str, Any]

    def to_yaml(self) -> str:
        """Return the section `priors` of a pipeline."""
        entry = {"use": self.offer.use, **self.settings}
        return to_yaml({_PRIORS.section: [escape_variables(entry)]})


@dataclass(frozen=True)
class Trial:
    """A tried guess with its prior, and the score and duration of one prediction."""

    guess: Guess
    prior: Prior[Any]
    score: Score
    seconds: float


def guesses(model: OnnxModel | Path, plugins: Plugins, changes: Sequence[str] = ()) -> list[Guess]:
    """Return the suggestions of the installed priors, sorted by name.

    Args:
        model: the model, or the path of a TorchScript file.
        changes: `key=value` texts that replace suggested settings.

    Raises:
        PluginError: no prior supports the file's inputs and outputs.
        PipelineError: a change cannot be parsed.
    """
    found = [
        Guess(offer, _changed(offer, dict(settings), changes))
        for offer in plugins.all()
        if offer.point is _PRIORS
        for settings in _suggested(offer.component, model)
    ]
    if not found:
        raise PluginError(
            "no installed prior supports a file with these inputs and outputs",
            where=str(model if isinstance(model, Path) else model.path),
            fix="docs/prior_models.md lists the supported inputs and outputs; other files need a plugin "
            "whose `settings_for` recognizes them",
        )
    return [guess for index, guess in enumerate(found) if guess not in found[:index]]


def _suggested(component: type, model: OnnxModel | Path) -> Sequence[Mapping[str, Any]]:
    if isinstance(model, Path):
        if issubclass(component, RunsTorchScript):
            return component.settings_for_script(model)
        return []
    return component.settings_for(model) if issubclass(component, RunsOnnxFiles) else []


def known_truth(plugins: Plugins, device: Device) -> Truth:
    """Load the scene that guesses are tried on."""
    with resources.as_file(resources.files(__package__) / "prior_check.yaml") as path:
        scene = find_loader(path, plugins).load(device)
    return truth_of(scene.train, scene.bounds)


def attempt(guess: Guess, truth: Truth, device: Device) -> Trial:
    """Build the prior, run it and score the result.

    Raises:
        ExplainedError: the prior rejects the settings, or the network fails.
    """
    written = to_yaml(escape_variables({"use": guess.offer.use, **guess.settings}))
    node = parse(written, "the suggested settings")
    item = component_item(_PRIORS, node, lambda *_: guess.offer, iterations=1)
    assert item is not None
    prior = build_part(item, 0, device).component
    begin = time.perf_counter()
    with blamed(item):
        result = score(prior, truth)
    return Trial(guess, prior, result, time.perf_counter() - begin)


def _changed(offer: Offer, settings: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    root = parse(Guess(offer, settings).to_yaml(), "the suggested settings")
    for text in changes:
        apply_override(root, f"{_PRIORS.section}.{offer.name}.{text}")
    assert isinstance(root.content, dict)
    (item,) = plain(root.content[_PRIORS.section])
    return {key: value for key, value in item.items() if key != "use"}


@dataclass(frozen=True)
class Score:
    """The score of a prior.

    Args:
        error: 0 if all is correct, 1 if nothing is; for monocular depth, 1 minus the rank correlation.
        text: a description with units.
    """

    error: float
    text: str


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a rectified pair of views.

    Args:
        views: all views; the first two are the left and right view of the pair, with depth.
        bounds: (near, far) z-depth, world units.
        moved: `[H, W, 2]` flow from the first view to the second, pixels.
        visible: `[H, W]` bool, pixels of the first view that the second view shows too.
    """

    views: tuple[TrainingView, ...]
    bounds: tuple[float, float]
    moved: Tensor
    visible: Tensor


def truth_of(views: tuple[TrainingView, ...], bounds: tuple[float, float]) -> Truth:
    """Compute the ground truth from the depths of the first two views.

    Raises:
        PluginError: one of them has no depth.
    """
    first, second = views[:2]
    depth, other = (_depth(view) for view in (first, second))
    u, v = first.camera.pixel_centers()
    points = first.camera.unproject(u.ravel(), v.ravel(), depth.ravel())
    there_u, there_v, there_z = (x.reshape(depth.shape) for x in second.camera.project(points))
    height, width = other.shape
    inside = second.camera.contains(there_u, there_v)
    column, row = there_u.clamp(0, width - 1).long(), there_v.clamp(0, height - 1).long()
    same = (other[row, column] - there_z).abs() <= _SAME_SURFACE * there_z
    moved = torch.stack([there_u - u, there_v - v], dim=2)
    return Truth(views, bounds, moved, inside & same)


def score(prior: Prior[Any], truth: Truth) -> Score:
    """Run a prior, without the cache, and compare its prediction with the ground truth.

    Raises:
        PluginError: the prior fails, or its capability is not supported.
    """
    first, second = truth.views[:2]
    if isinstance(prior, StereoPrior):
        disparity = prior.disparity(first.image, second.image)
        errors = (disparity.values + truth.moved[..., 0]).abs()
        return _pixels(errors.where(disparity.valid, torch.inf)[truth.visible])
    if isinstance(prior, OpticalFlowPrior):
        flow = prior.flow(first.image, second.image)
        errors = (flow.vectors - truth.moved).norm(dim=2)
        return _pixels(errors.where(flow.valid, torch.inf)[truth.visible])
    if isinstance(prior, MultiViewDepthPrior):
        return _depths(prior, truth)
    if isinstance(prior, GaussiansPrior):
        return _surface(prior, truth)
    if isinstance(prior, PosedDepthPrior):
        return _reprojected(prior, truth)
    if isinstance(prior, MonocularDepthPrior):
        found = prior.depth(first.image)
        return _order(-found.farness, 1 / _depth(first), found.valid)
    if isinstance(prior, MatchingPrior):
        return _matches(prior, truth)
    raise PluginError(f"priors of the capability {prior.capability!r} cannot be scored")


def _depth(view: TrainingView) -> Tensor:
    if view.depth is None:
        raise PluginError(f"the view {view.name!r} has no depth to compare with")
    return view.depth.double()


def _pixels(errors: Tensor) -> Score:
    """Score errors of visible pixels; infinite without a prediction."""
    known = errors[torch.isfinite(errors)]
    wrong = float((errors > PIXELS).double().mean())
    middle = f"{float(known.median()):.2f} px" if len(known) else "none"
    return Score(
        wrong,
        f"{wrong:.1%} of the pixels that both images show are off by more than {PIXELS:g} px or "
        f"missing; {len(known) / len(errors):.0%} have a prediction, median error {middle}",
    )


def _surface(prior: GaussiansPrior[Any], truth: Truth) -> Score:
    """Score the nearest opaque Gaussian of each pixel of the first view by its depth."""
    view = truth.views[0]
    found = prior.estimate(truth.views, truth.bounds)
    u, v, z = view.camera.project(found.positions.double())
    seen = view.camera.contains(u, v) & (z > 0)
    if found.opacities is not None:
        seen &= found.opacities >= 0.5
    expected = _depth(view)
    pixels = v[seen].long() * view.camera.width + u[seen].long()
    nearest = torch.full((expected.numel(),), torch.inf, dtype=torch.float64)
    nearest.scatter_reduce_(0, pixels, z[seen], "amin")
    known = nearest.isfinite()
    right = known & ((nearest / expected.ravel() - 1).abs() <= RELATIVE_DEPTH)
    share, of_known = (float(right.double().mean()), float(right.sum() / known.sum().clamp(min=1)))
    return Score(
        1 - of_known,
        f"nearest Gaussian correct within {RELATIVE_DEPTH:.0%} in {of_known:.1%} of the pixels with one, and "
        f"in {share:.1%} of all",
    )


def _depths(prior: MultiViewDepthPrior[Any], truth: Truth) -> Score:
    answer = prior.estimate(truth.views, truth.bounds)[0]
    expected = _depth(truth.views[0])
    errors = (answer.depth - expected).abs() / expected
    right = answer.valid & (errors <= RELATIVE_DEPTH)
    share = float(right.double().mean())
    known = float(answer.valid.double().mean())
    of_known = share / known if known else 0.0
    return Score(
        1 - share,
        f"depth correct within {RELATIVE_DEPTH:.0%} in {share:.1%} of all pixels, and in {of_known:.1%} "
        f"of the {known:.0%} with a prediction",
    )


def _reprojected(prior: PosedDepthPrior[Any], truth: Truth) -> Score:
    """Score where cameras and depth of the first view place its pixels in the second: without any unit."""
    first, second = prior.estimate(*asked(prior, truth.views))[:2]
    height, width = truth.visible.shape
    here, there = (_camera(answer, width, height) for answer in (first, second))
    u, v = here.pixel_centers()
    points = here.unproject(u.ravel(), v.ravel(), first.depth.double().ravel())
    there_u, there_v, there_z = (x.reshape(u.shape) for x in there.project(points))
    errors = (torch.stack([there_u - u, there_v - v], dim=2) - truth.moved).norm(dim=2)
    known = errors.isfinite() & (first.depth > 0) & (there_z > 0)
    return _pixels(errors.where(known, torch.inf)[truth.visible])


def asked(
    prior: PosedDepthPrior[Any], views: Sequence[TrainingView]
) -> tuple[list[Tensor], list[Tensor | None]]:
    """Return images and unknown intrinsics for a call, with the last view again if there are too few."""
    least, most = prior.accepted_views
    wanted = max(least, min(len(views), most or len(views)))
    images = [views[min(k, len(views) - 1)].image for k in range(wanted)]
    return images, [None] * wanted


def _camera(answer: PosedDepth, width: int, height: int) -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = answer.world_to_camera[:3]
    (fx, _, cx), (_, fy, cy), _ = answer.intrinsics.tolist()
    return Camera(pose, fx, fy, cx, cy, width, height)


def _order(answer: Tensor, expected: Tensor, valid: Tensor | None) -> Score:
    """Score by Spearman's rank correlation of the valid pixels, which ignores scale and shift."""
    from scipy.stats import spearmanr

    if valid is not None:
        answer, expected = answer[valid], expected[valid]
    if not answer.numel() or answer.min() == answer.max():
        return Score(1.0, "the same prediction for every pixel")
    correlation = float(spearmanr(answer.ravel().numpy(), expected.ravel().numpy()).statistic)
    return Score(1 - correlation, f"rank correlation {correlation:.2f} with the true inverse depth")


def _matches(prior: MatchingPrior[Any], truth: Truth) -> Score:
    found = prior.matches(*(view.image for view in truth.views[:2]))
    height, width = truth.visible.shape
    column = found.first[:, 0].clamp(0, width - 1).long()
    row = found.first[:, 1].clamp(0, height - 1).long()
    errors = (found.second - found.first - truth.moved[row, column]).norm(dim=1)
    if not len(errors):
        return Score(1.0, "no matches")
    wrong = float((errors > PIXELS).double().mean())
    return Score(
        wrong,
        f"{len(errors)} matches, {wrong:.1%} of them off by more than {PIXELS:g} px, "
        f"median error {float(errors.median()):.2f} px",
    )
