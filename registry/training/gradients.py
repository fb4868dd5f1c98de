"""The loss of an iteration, its backward pass, and the trainable parameters of components.

Only finite gradients reach the optimizer. The checks cost nothing without a failure: the loss is read anyway,
and the engine checks the gradients of images and parameters as it reads them. After a failure the terms are
differentiated one by one, to find the component that caused it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import reduce

import torch
from torch import Tensor

from core_rasterizer import ExplainedError, GaussianReader, Model, Rendering
from core_rasterizer.gaussians import undefined_places

from ..calls.blame import blame
from ..calls.policy import plugins_are_checked
from ..calls.read_only_guard import ReadOnlyGuard
from ..calls.watchdog import Hang
from ..contract.component import GaussianFeature, ParameterGroup
from ..contract.step import Step
from ..errors import PluginError, RunError
from ..pipeline.parts import Part, Parts
from ..pipeline.pipeline import Item
from ..pipeline.training_settings import TrainingSettings

FEW = 0.01
"""Share of the visible Gaussians; nearly all have a gradient in a usual training."""
FAINTEST = 1 / 255
"""Opacity below which a Gaussian is not rendered."""
FEATURES = "features"
"""Prefix of the features in `ComponentParameters.state`."""
_IN_FILES = ("f_dc", "f_rest", "scale", "rot")
"""Properties of PLY files that end in numbers, as those of features do."""
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True, eq=False)
class Term:
    """A term of the loss.

    Args:
        item: its regularizer; None for the photometric term.
        value: scalar with gradient, including the weight.
    """

    item: Item | None
    value: Tensor


def photometric_term(
    settings: TrainingSettings, shown: Tensor | Rendering, step: Step, model: Model
) -> Term:
    """Return L1 and D-SSIM between colours, or a render, and the target of the iteration.

    With weights w the target is x + w (target - x), x being the colours without gradient, and the gradient
    is multiplied by w: pixels of weight 0 add nothing, not even through the windows of SSIM around them.

    Raises:
        RunError: the colours are not finite.
    """
    target, weights = step.sample.target, step.sample.weights
    if weights is not None:
        colors = shown if isinstance(shown, Tensor) else shown.rgb
        fixed, share = colors.detach(), weights[..., None]
        shown, target = fixed.lerp(colors, share), fixed.lerp(target, share)
    try:
        loss = model.engine.loss(shown, target, settings.ssim_weight, settings.l1_weight)
    except ExplainedError as error:
        raise RunError(
            error.what,
            where=f"iteration {step.iteration}, view {step.view.name!r}",
            fix="lower the learning rates; the last checkpoint, if any, is intact",
        ) from error
    return Term(None, loss)


def without_gradient(model: Model, rendering: Rendering) -> str | None:
    """Return the likely cause and a remedy if almost no visible Gaussian's colour has a gradient, else None.

    Args:
        model: after the backward pass.
        rendering: of the same iteration.
    """
    visible = int(rendering.visible.sum())
    colors = model.gradient_of_renders("sh_constant")
    if int(colors.any(dim=0).sum()) > FEW * visible:
        return None
    if visible:
        return (
            "nearly all colours are 0 or less, where they have no gradient, probably because the points have "
            "no colours; use an initializer that takes them from the photographs"
        )
    if float(model.opacities().max()) < FAINTEST:
        return (
            "all opacities are below 1/255; let opacity policies and losses act later or less often"
        )
    return "no Gaussian is in it; `stereogs check` shows the cameras and the initial points"


def backward(
    terms: Sequence[Term],
    iteration: int,
    model: Model,
    parameters: ComponentParameters,
    guard: ReadOnlyGuard,
    colors: Sequence[tuple[Item, Tensor]] = (),
) -> float:
    """Run the backward pass, and return the loss.

    Args:
        terms: terms of the loss, in order of summation.
        model, parameters: receive the gradients.
        guard: data that hooks of components must not write into.
        colors: each appearance, in order, with its input.

    Raises:
        ExplainedError: the loss or a gradient is not finite, or the backward pass of a component failed;
            names the component.
    """
    loss = reduce(torch.add, [term.value for term in terms])
    total = float(loss.detach())
    if not math.isfinite(total):
        _refuse_loss(terms, iteration)
    kept = replace(guard, models=())
    with in_iteration(iteration):
        parameters.check_untouched(iteration)
        try:
            with kept.kept(every_bit=plugins_are_checked()):
                loss.backward(retain_graph=True)
            parameters.check_gradients(iteration)
        except (KeyboardInterrupt, Hang):
            raise
        except BaseException as error:  # a hook may raise SystemExit
            _differentiate_each(terms, iteration, model, parameters, kept, colors)
            if isinstance(error, Exception):
                raise
            raise RunError(f"the backward pass ended with {type(error).__name__}") from error
    return total


@contextmanager
def in_iteration(iteration: int) -> Iterator[None]:
    """Add the iteration to errors of the block that lack it."""
    try:
        yield
    except ExplainedError as error:
        if "iteration" not in error.where:
            place = f"iteration {iteration}"
            error.where = f"{error.where}; {place}" if error.where else place
        raise


def zero_gradients(model: Model, parameters: ComponentParameters) -> None:
    """Clear the gradients of the Gaussians and of the components' parameters."""
    model.zero_gradients()
    parameters.zero_gradients()


def _refuse_loss(terms: Sequence[Term], iteration: int) -> None:
    """Name the first term that is not finite; each was finite before the weight."""
    what = "the loss is too large for single precision"
    fix = "lower the weight of the term, or its size"
    for term in terms:
        if term.item is not None and not math.isfinite(float(term.value.detach())):
            with blame(term.item, iteration):
                raise PluginError(f"{what}: this term times its weight is", fix=fix)
    raise RunError(what, where=f"iteration {iteration}", fix=fix)


def _differentiate_each(
    terms: Sequence[Term],
    iteration: int,
    model: Model,
    parameters: ComponentParameters,
    kept: ReadOnlyGuard,
    colors: Sequence[tuple[Item, Tensor]],
) -> None:
    """Differentiate the terms one by one; the first that fails raises with the name of its component."""
    for term in terms:
        if not term.value.requires_grad:
            continue
        zero_gradients(model, parameters)
        for item, before in reversed(colors) if term.item is None else ():
            with blame(item, iteration), kept.kept(every_bit=plugins_are_checked()):
                (gradient,) = torch.autograd.grad(
                    term.value, before, retain_graph=True, allow_unused=True
                )
                what = "the colours have an undefined gradient"
                check_finite(gradient, what, "pixel and channel")
        with (
            nullcontext() if term.item is None else blame(term.item, iteration),
            kept.kept(every_bit=plugins_are_checked()),
        ):
            term.value.backward(retain_graph=True)
            parameters.check_gradients(iteration)


class ComponentParameters:
    """The parameters and the features of all components of a pipeline, with one Adam for each set.

    Args:
        parts: `parameters` and `features` of each component are called once.
        model: the Gaussians that features belong to.

    Attributes:
        features: numbers per Gaussian by name, leaves (`Component.features`).

    Raises:
        PluginError: a group has a tensor that is not a leaf with gradient, a repeated name, or a negative
            learning rate; or a feature is not one finite row for each Gaussian.
    """

    def __init__(self, parts: Parts, model: GaussianReader) -> None:
        self._trained: list[tuple[Part, tuple[ParameterGroup, ...], torch.optim.Adam]] = []
        self.features: dict[str, Tensor] = {}
        self._feature_optimizers: dict[str, torch.optim.Adam] = {}
        for part in parts:
            with part.at_work():
                groups = tuple(part.component.parameters())
                if groups:
                    check_groups(groups)
                    options = [{"params": list(g.tensors), "lr": g.learning_rate} for g in groups]
                    self._trained.append((part, groups, torch.optim.Adam(options)))
        for part in parts.training:
            with part.at_work():
                for feature in part.component.features(model):
                    check_feature(feature, model.count, self.features)
                    self._add(part, feature)

    def _add(self, part: Part, feature: GaussianFeature) -> None:
        name, rate = feature.name, feature.learning_rate
        leaf = feature.values.detach().clone().requires_grad_(rate > 0)
        self.features[name] = leaf
        self._feature_optimizers[name] = torch.optim.Adam([leaf], lr=rate)
        group = ParameterGroup(name, (leaf,), rate)
        self._trained.append((part, (group,), self._feature_optimizers[name]))

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Apply an edit to the features and their moments; see `Component.carry`.

        As in 3DGS, new Gaussians have zero moments, and gradients from before the edit are dropped.
        """
        for number, (part, (group, *_), optimizer) in enumerate(self._trained):
            if self._feature_optimizers.get(group.name) is not optimizer:
                continue
            (old,) = group.tensors
            leaf = old.detach()[source].requires_grad_(old.requires_grad)
            self.features[group.name] = leaf
            moments = optimizer.state.pop(old, {})
            optimizer.param_groups[0]["params"] = [leaf]
            if moments:
                optimizer.state[leaf] = {
                    key: value[source].masked_fill(fresh[:, None], 0) if value.ndim else value
                    for key, value in moments.items()
                }
            self._trained[number] = part, (replace(group, tensors=(leaf,)),), optimizer

    @property
    def tensors(self) -> Iterator[Tensor]:
        """All parameters."""
        return (tensor for _, tensor, _ in self._named())

    def check_untouched(self, iteration: int) -> None:
        """Refuse gradients that a component made before the host's backward pass."""
        for part, groups, _ in self._trained:
            if any(tensor.grad is not None for group in groups for tensor in group.tensors):
                with blame(part.item, iteration):
                    raise PluginError(
                        "its parameters have a gradient before the backward pass",
                        fix="return the loss, and leave `backward` to the host",
                    )

    def zero_gradients(self) -> None:
        """Clear the gradients."""
        for _, _, optimizer in self._trained:
            optimizer.zero_grad(set_to_none=True)

    def check_gradients(self, iteration: int) -> None:
        """Refuse gradients that are not finite, before any step."""
        for part, groups, _ in self._trained:
            with blame(part.item, iteration):
                for group in groups:
                    for number, tensor in enumerate(group.tensors):
                        what = "the gradient of its parameters is not finite"
                        check_finite(tensor.grad, what, f"{group.name}, tensor {number}:")

    def step(self) -> None:
        """Step each Adam; tensors without gradient do not change."""
        for _, _, optimizer in self._trained:
            optimizer.step()

    def state(self) -> dict[str, Tensor]:
        """Return values and moments, by slash-separated names."""
        state: dict[str, Tensor] = {}
        for name, tensor, optimizer in self._named():
            state[f"{name}/value"] = tensor.detach().clone()
            moments = optimizer.state.get(tensor, {})
            state |= {f"{name}/{key}": moments[key].clone() for key in moments}
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore the result of `state`."""
        for name, tensor, optimizer in self._named():
            with torch.no_grad():
                tensor.copy_(state[f"{name}/value"])
            known = {key: state.get(f"{name}/{key}") for key in _MOMENTS}
            moments = {key: value.clone() for key, value in known.items() if value is not None}
            if moments:
                optimizer.state[tensor] = moments

    def _named(self) -> Iterator[tuple[str, Tensor, torch.optim.Adam]]:
        for part, groups, optimizer in self._trained:
            for group in groups:
                if self._feature_optimizers.get(group.name) is optimizer:
                    yield f"{FEATURES}/{group.name}", group.tensors[0], optimizer
                    continue
                for index, tensor in enumerate(group.tensors):
                    yield f"{part.item.qualified_name}/{group.name}/{index}", tensor, optimizer


def check_finite(gradient: Tensor | None, what: str, place: str) -> None:
    """Refuse a gradient that is not finite; `what` and `place` describe it in the message."""
    if gradient is None:
        return
    undefined = undefined_places(gradient)
    if len(undefined):
        raise PluginError(
            f"{what} in {len(undefined)} values",
            where=f"{place} {undefined[0].tolist()}",
            fix="look for a division by zero or a square root of zero",
        )


def check_feature(feature: GaussianFeature, count: int, known: Mapping[str, Tensor]) -> None:
    """Refuse a feature that is not one finite row for each of `count` Gaussians, or whose name is known.

    Raises:
        PluginError: see `ComponentParameters`.
    """
    name, values = feature.name, feature.values
    wrong = "is given twice" if name in known else ""
    if not _WORD.fullmatch(name):
        wrong = "is not a word of letters, digits and '_'"
    elif name in _IN_FILES:
        wrong = "is a property of every PLY file"
    if wrong:
        raise PluginError(f"the feature name {name!r} {wrong}", fix="choose another name")
    if values.ndim != 2 or len(values) != count or not values.shape[1]:
        raise PluginError(
            f"the feature {name!r} has the shape {tuple(values.shape)}, expected ({count}, channels)",
            fix="return one row for each Gaussian of `model`",
        )
    if values.dtype != torch.float32 or not bool(values.isfinite().all()):
        raise PluginError(
            f"the feature {name!r} is {values.dtype}, or not finite",
            fix="return finite float32 numbers",
        )
    if not feature.learning_rate >= 0:
        raise PluginError(f"the learning rate of {name!r} is {feature.learning_rate}")


def check_groups(groups: Sequence[ParameterGroup]) -> None:
    """Refuse groups that cannot be trained.

    Raises:
        PluginError: see `ComponentParameters`.
    """
    names = [group.name for group in groups]
    if len(set(names)) < len(names):
        raise PluginError(f"two groups of parameters share a name: {', '.join(names)}")
    for group in groups:
        if not group.learning_rate >= 0:
            raise PluginError(f"the learning rate of {group.name!r} is {group.learning_rate}")
        for tensor in group.tensors:
            if not (tensor.is_leaf and tensor.requires_grad and tensor.is_floating_point()):
                raise PluginError(
                    f"the group {group.name!r} holds a tensor that cannot be trained",
                    fix="use torch leaves made with requires_grad=True",
                )
