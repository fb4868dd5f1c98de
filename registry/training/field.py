"""One field of Gaussians in training: a model, its optimizer and its components.

The public methods from `begin` to `perturb` are the stages of an iteration, in this order. `trainer.py` calls
each stage for all fields before the next.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import ceil
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Carried, Edit, GaussianReader, Model, Rendering
from core_rasterizer.layout import PARAMETER_GROUPS

from ..calls.blame import blame
from ..calls.policy import RENDER_GRADIENT_EVERY
from ..calls.read_only_guard import (
    NOTHING,
    ReadOnlyGuard,
    of_kinds,
    of_maps,
    of_rendering,
    of_sample,
    of_scene,
)
from ..contract.checks.answers import check_moves
from ..contract.components import OpacityUpdate
from ..contract.rendered import COLLECTED, Access
from ..contract.scene import DepthMap, TrainingScene, TrainingView
from ..contract.step import OtherField, Sample, Step
from ..errors import PluginError, RunError
from ..events import IterationDone
from ..pipeline.parts import Part, Parts, derived_seed
from ..pipeline.pipeline import Item
from ..pipeline.schedule import active_sh_degree
from ..pipeline.training_settings import TrainingSettings
from .gradients import (
    ComponentParameters,
    Term,
    backward,
    photometric_term,
    without_gradient,
    zero_gradients,
)
from .growth_limit import limited, without_growth
from .step import OUTPUTS, StepReader, learning_rates, step_renderer

OPACITY_MARGIN = 1e-6
"""Smallest distance of opacities from 0 and 1, so that logits stay finite."""

HOST_NUMBERS = frozenset(("iteration", "seconds", "gaussians", "loss", "photometric", "test"))
"""Names in metrics.jsonl that components must not log; nor may they log names of loss terms."""

_log = logging.getLogger(__name__)


class Field:
    """A model in training.

    Args:
        settings: settings of the loop.
        scene: the scene without test views and true depth.
        maps: depth maps of the training views from the initializer.
        parts: components of the field.
        model: the Gaussians, changed in place.
        index: number of the field; field 0 is scored.
        kinds: kinds of the initial points (`PointCloud.kinds`).
        first_sh_degree: SH bands in use from the first iteration.

    Attributes:
        prefix: of its state and of its logged numbers, empty for field 0.
        kinds: which Gaussians descend from points of a kind, `[N]` bool by its name.
        logged: numbers logged in this iteration, by name.
        guard: data that components receive in this iteration, and may only read.
    """

    guard: ReadOnlyGuard
    _step: Step
    _rendering: Rendering

    def __init__(
        self,
        settings: TrainingSettings,
        scene: TrainingScene,
        maps: Mapping[str, DepthMap],
        parts: Parts,
        model: Model,
        index: int,
        kinds: Mapping[str, Tensor] | None = None,
        first_sh_degree: int = 0,
    ) -> None:
        self._first_sh_degree = first_sh_degree
        self.index, self.parts, self.model = index, parts, model
        self.prefix = f"field{index}/" if index else ""
        self.kinds = dict(kinds or {})
        self.logged: dict[str, float] = {}
        self.optimizer = model.engine.optimizer(model)
        self._settings, self._scene, self._maps = settings, scene, maps
        self._inputs = of_scene(scene) + of_maps(maps)
        for part in parts.training:
            with part.at_work(guard=self._inputs):
                part.component.begin_training(scene)
        self.parameters = ComponentParameters(parts, GaussianReader(model))
        self._extent, self._reader = scene.extent, GaussianReader(model)
        self._access = Access()
        self._step_reader = StepReader(model, self._access)
        asking = [part for part in parts.training if part.item.host.weight > 0 and part.declared]
        # The host itself ranks the Gaussians that `max_gaussians` drops.
        ranked = () if settings.max_gaussians is None else parts["densification"]
        self._collecting = [*(part for part in asking if part.declared & COLLECTED), *ranked]
        self._served = [part for part in asking if part.declared & OUTPUTS.keys()]
        name = f"topology/{index}" if index else "topology"
        self._topology = torch.Generator().manual_seed(derived_seed(settings.seed, name))
        self._no_gradient: str | None = None
        self._limit_logged = self._edited = self._reset = False
        self._follow_kinds()

    def _follow_kinds(self) -> None:
        self._trained = [self.model.anchor, *self.parameters.tensors]
        features = {f"the feature {name}": v for name, v in self.parameters.features.items()}
        self._guard = self._inputs + of_kinds(self.kinds) + ReadOnlyGuard(features, (self.model,))

    def begin(self, iteration: int, view: TrainingView) -> None:
        """Apply schedules and samplers."""
        settings, scene = self._settings, self._scene
        vars(self).pop("_rendering", None)  # the next render uses its memory
        self.logged = {}
        degree = active_sh_degree(
            iteration, settings.sh_degree, settings.sh_every, self._first_sh_degree
        )
        sample = Sample(
            view, view.camera, view.image, scene.background, degree, weights=view.weights
        )
        self.guard = self._guard
        self._step = Step(
            iteration=iteration,
            iterations=settings.iterations,
            scene=scene,
            sample=sample,
            model=self._step_reader,
            extent=self._extent,
            priors=self.parts.priors,
            render=step_renderer(self.model, sample),
            log=self._log_for_component,
            maps=self._maps,
            learning_rates=MappingProxyType(learning_rates(iteration, settings, self._extent)),
            kinds=MappingProxyType(self.kinds),
            features=MappingProxyType(self.parameters.features),
            makers=OUTPUTS,
            access=self._access,
        )
        for part in self.parts.due("samplers", iteration):
            sample = self.call(part, self._step.sample)
            if sample is not self._step.sample:
                render = step_renderer(self.model, sample)
                self._step = replace(self._step, sample=sample, render=render)
        # Adam steps the SH bands in use, and one that fades in.
        self._bands = ceil(self._step.sample.sh_degree)

    def step_terms_alone(self) -> None:
        """Step the terms that have their own backward pass and optimizer step."""
        step = self._step
        for part in self._regularizers("alone"):
            zero_gradients(self.model, self.parameters)
            step.rendered(cache(lambda: step.render(step.sample.camera)))
            if part in self._served:
                self._serve([part])
            with part.at_work(step.iteration, self.guard):
                moves = check_moves(part.component.moves, PARAMETER_GROUPS)
            term = self._term(part)
            if term.value.requires_grad:  # a term of zero may have none
                backward([term], step.iteration, self.model, self.parameters, self.guard)
                moved = PARAMETER_GROUPS if moves is None else moves
                fixed = tuple(name for name in PARAMETER_GROUPS if name not in moved)
                self.optimizer.step(step.learning_rates, self._bands, skip=fixed)
                self.parameters.step()
            step.rendered(None)

    def render(self) -> None:
        """Apply modifiers, and render the view of the iteration."""
        step, sample = self._step, self._step.sample
        zero_gradients(self.model, self.parameters)
        scale: Tensor | None = None
        for part in self.parts.due("modifiers", step.iteration):
            factor: Tensor = self.call(part)
            scale = factor if scale is None else scale * factor
        collecting = [  # for a call in this or a later iteration
            part for part in self._collecting if not part.item.schedule.over(step.iteration)
        ]
        self._rendering = self.model.render(
            sample.camera,
            background=sample.background,
            sh_degree=sample.sh_degree,
            opacity_scale=scale,
            smoothing=sample.smoothing,
            collect_statistics=bool(collecting),
            collect_absolute=any("absolute_screen_gradient" in p.declared for p in collecting),
        )
        self._changed_images = self._rendering.watch()
        self.guard += of_rendering(self._rendering) + of_sample(sample)
        step.rendered(lambda: self._rendering)
        if self._served:
            due = [part for part in self._served if part.item.host.due(step.iteration)]
            self._serve([part for part in due if part.item.host.step == "together"])

    def _serve(self, parts: Sequence[Part]) -> None:
        """Make the outputs that components declare, once for all, and guard them."""
        names = OUTPUTS.keys() & {name for part in parts for name in part.declared}
        if names:
            self._access.declared = names
            made = {f"the {name}": self._step.output(name) for name in sorted(names)}
            self.guard += ReadOnlyGuard(made)

    def differentiate(self, fields: Sequence[Field]) -> float:
        """Run the backward pass, and return the total loss; losses may read the other fields."""
        step = self._step
        others = [
            OtherField(
                index=other.index,
                model=other._reader,
                rendering=other._rendering.detach(),
                render=step_renderer(other.model, other._step.sample, gradients=False),
            )
            for other in fields
            if other is not self
        ]
        step.rendered(lambda: self._rendering, tuple(others))
        shown: Any = self._rendering
        colors: list[tuple[Item, Tensor]] = []
        for part in self.parts.due("appearances", step.iteration):
            before = shown if colors else shown.rgb
            guard = ReadOnlyGuard({"the colours": before})
            shown = self.call(part, before, guard=guard, trained=[self.model.anchor])
            colors.append((part.item, before))
        photometric = photometric_term(self._settings, shown, step, self.model)
        self.logged["photometric"] = float(photometric.value.detach())
        terms = [photometric]
        terms += map(self._term, self._regularizers("together"))
        for name in self._changed_images():
            due = [*self.parts.due("appearances", step.iteration), *self._regularizers("together")]
            raise PluginError(
                f"a component wrote into the rendered {name}, which it may only read",
                where=f"one of {', '.join(part.item.qualified_name for part in due)}",
                fix="train again with --check-plugins, which names the component",
            )
        loss = backward(terms, step.iteration, self.model, self.parameters, self.guard, colors)
        if step.iteration % RENDER_GRADIENT_EVERY == 1 and not self._no_gradient:
            self._no_gradient = without_gradient(self.model, self._rendering)
            if self._no_gradient:
                where = f"iteration {step.iteration}, view {step.view.name}"
                _log.warning("%s: the render has no gradient: %s", where, self._no_gradient)
        return loss

    def update_opacities(self) -> None:
        """Apply the opacity policies, in the order of the pipeline."""
        self._reset = False
        for part in self.parts.due("opacity", self._step.iteration):
            update: OpacityUpdate | None = self.call(part)
            if update is not None:
                kept = update.opacities.float().clamp(OPACITY_MARGIN, 1 - OPACITY_MARGIN)
                self.model.write("opacity_logits", torch.logit(kept))
                self._reset |= update.reset_moments

    def change_topology(self) -> None:
        """Apply the densification policies."""
        self._edited = spent = False
        iteration = self._step.iteration
        for part in self.parts.due("densification", iteration):
            if spent and part.declared & COLLECTED:  # what it reads was reset
                continue
            count = self.model.count
            wanted: Edit | None = self.call(part)
            if wanted is None:
                continue
            spent = True
            edit = self._within_limits(wanted)
            if edit.empty:
                self.model.statistics.reset()
                continue
            with blame(part.item, iteration):
                carried = self._carry(edit)
            self._step = replace(self._step, kinds=MappingProxyType(self.kinds))
            self._step.carry_outputs(carried.source)
            self.parts.carry(carried.source, carried.fresh, count, iteration)
            self._edited = True

    def prune(self, mask: Tensor, iteration: int) -> None:
        """Remove the Gaussians of a mask `[N]` bool after an iteration, with all that belongs to them.

        Raises:
            GaussianError: none would remain.
        """
        count = self.model.count
        carried = self._carry(Edit(prune=mask))
        self.parts.carry(carried.source, carried.fresh, count, iteration)

    def _carry(self, edit: Edit) -> Carried:
        """Edit the Gaussians, and what the host keeps for each."""
        carried = self.model.engine.edit(self.model, self.optimizer, edit, self._topology)
        self.kinds = {name: mask[carried.source] for name, mask in self.kinds.items()}
        self.parameters.carry(carried.source, carried.fresh)
        self._follow_kinds()
        return carried

    def step_optimizer(self) -> None:
        """Step Adam for the Gaussians and the components' parameters."""
        rates = dict(self._step.learning_rates)
        if self._reset:
            # As in 3DGS, opacities that were reset take no step from the gradient before the reset.
            rates["opacity_logits"] = 0.0
        if not self._edited:
            # As in 3DGS: gradients of the Gaussians before an edit do not move those after it.
            self.optimizer.step(rates, self._bands, keep_gradients=False)
        if self._reset:
            self.optimizer.reset_moments("opacity_logits")
        self.parameters.step()

    def perturb(self) -> None:
        """Add the offsets of perturbations to the parameters."""
        for part in self.parts.due("perturbations", self._step.iteration):
            offsets: Mapping[str, Tensor] = self.call(part)
            with blame(part.item, self._step.iteration):
                for name, offset in offsets.items():
                    self.model.write(name, self.model.read(name) + offset)

    def done(self, loss: float, numbers: Mapping[str, float], seconds: float) -> IterationDone:
        """Return the complete iteration for observers.

        Args:
            loss, numbers: results of the iteration.
            seconds: training time so far.
        """
        return IterationDone(
            iteration=self._step.iteration,
            seconds=seconds,
            loss=loss,
            numbers=MappingProxyType(dict(numbers)),
            gaussians=self.model.count,
            learning_rates=self._step.learning_rates,
            view=self._step.view,
            target=self._step.sample.target,
            rendering=self._rendering.detach(),
            model=self._reader,
        )

    def call(
        self,
        part: Part,
        *given: Any,
        guard: ReadOnlyGuard = NOTHING,
        trained: Sequence[Tensor] = (),
    ) -> Any:
        """Call a component with the step, and return its checked answer.

        Args:
            given: arguments besides the step.
            guard: data that it receives besides that of all components.
            trained: leaves; a gradient of the answer must reach one of them.
        """
        step, guard = self._step, self.guard + guard
        self._access.declared = part.declared
        return part.call(step, *given, iteration=step.iteration, guard=guard, trained=trained)

    def _term(self, part: Part) -> Term:
        """Return the term of a regularizer times its weight, and log it without the weight."""
        term: Tensor = self.call(part, trained=self._trained)
        self.logged[part.item.qualified_name] = float(term.detach())
        return Term(part.item, part.item.host.weight * term)

    def _regularizers(self, step: str) -> Iterator[Part]:
        """Yield those that are due and stepped "alone" or "together"."""
        due = self.parts.due("regularizers", self._step.iteration)
        return (part for part in due if part.item.host.step == step)

    def _within_limits(self, edit: Edit) -> Edit:
        """Return an edit without growth in the last iteration or above `max_gaussians`."""
        settings, iteration = self._settings, self._step.iteration
        if iteration == settings.iterations:
            edit = without_growth(edit)
        if settings.max_gaussians is None:
            return edit
        rank = self.model.statistics.screen_gradient()
        edit, dropped = limited(edit, settings.max_gaussians, rank)
        if dropped and not self._limit_logged:
            self._limit_logged = True
            _log.warning(
                "iteration %d: max_gaussians (%d) is reached; growth is cut from here on",
                iteration,
                settings.max_gaussians,
            )
        return edit

    def _log_for_component(self, name: str, value: float) -> None:
        """Implement `Step.log`."""
        terms = {part.item.qualified_name for part in self.parts["regularizers"]}
        if name in HOST_NUMBERS | terms:
            raise PluginError(
                f"it logs {name!r}, a name that the host uses",
                fix="log it under another name",
            )
        self.logged[name] = float(value)

    def state(self, iteration: int) -> dict[str, Tensor]:
        """Return everything that the next iterations depend on, by slash-separated names."""
        kinds: dict[str, Mapping[str, Tensor]] = {
            "model": vars(self.model.gaussians()),
            "optimizer": self.optimizer.state(),
            "statistics": {"screen": self.model.statistics.sums()},
            "topology": {"generator": self._topology.get_state()},
            "components": self.parts.state(iteration),
            "parameters": self.parameters.state(),
            "kinds": {name: mask.clone() for name, mask in self.kinds.items()},
        }
        return {
            f"{self.prefix}{kind}/{name}": value
            for kind, values in kinds.items()
            for name, value in values.items()
        }

    def restore(self, part: Callable[[str], Mapping[str, Any]]) -> None:
        """Restore the result of `state`; the model must already hold the same Gaussians.

        Args:
            part: returns the tensors of `state` below a prefix, without it (`Checkpoint.part`).
        """
        self.optimizer.restore(part(f"{self.prefix}optimizer"))
        screen = part(f"{self.prefix}statistics")["screen"]
        if screen.shape[1:] != (self.model.count,) or len(screen) not in (2, 3):
            raise RunError(
                f"the statistics of {self.model.count} Gaussians are {tuple(screen.shape)}"
            )
        self.model.statistics.restore(screen)
        self._topology.set_state(part(f"{self.prefix}topology")["generator"])
        self.parts.restore(part(f"{self.prefix}components"))
        self.parameters.restore(part(f"{self.prefix}parameters"))
        self.kinds = dict(part(f"{self.prefix}kinds"))
        self._follow_kinds()
