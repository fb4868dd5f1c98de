"""One field of Gaussians in training: a model, its optimizer and its components.

Each method is one stage of an iteration; `trainer.py` defines their order.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Adam, Carried, Edit, GaussianModel, Rendering, apply_edit

from ..calls.read_only_guard import (
    ReadOnlyGuard,
    are_checked,
    of_kinds,
    of_maps,
    of_rendering,
    of_scene,
)
from ..contract.checks.answers import (
    check_colors,
    check_edit,
    check_offsets,
    check_opacity_scale,
    check_opacity_update,
    check_sample,
)
from ..contract.components import Densification
from ..contract.maps import DepthMap
from ..contract.scene import TrainingScene, TrainingView
from ..contract.step import OtherField, Sample, Step
from ..errors import PluginError, RunError
from ..events import IterationDone
from ..pipeline.blame import blame
from ..pipeline.parts import Parts
from ..pipeline.schedule import active_sh_degree
from ..pipeline.seeding import derived_seed
from ..pipeline.training_settings import TrainingSettings
from .component_parameters import ComponentParameters
from .growth_limit import limited, without_growth
from .guard import Recolored, Term, backward
from .learning_rates import learning_rates
from .losses import photometric_term, regularizing_terms, term_alone
from .step_rendering import StepRenderer

OPACITY_MARGIN = 1e-6
"""Smallest distance of opacities from 0 and 1, so that logits stay finite."""

HOST_NUMBERS = frozenset(("iteration", "seconds", "gaussians", "loss", "photometric", "test"))
"""Names in metrics.jsonl that components must not log; nor may they log names of loss terms."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Data that all fields of a run share.

    Args:
        settings: settings of the loop.
        scene: the scene without test views and true depth.
        maps: depth maps of the training views from the initializer.
    """

    settings: TrainingSettings
    scene: TrainingScene
    maps: Mapping[str, DepthMap]

    @cached_property
    def lent(self) -> ReadOnlyGuard:
        """The parts of it that components receive and must not change."""
        return of_scene(self.scene) + of_maps(self.maps)


class Field:
    """A model in training.

    Args:
        around: data shared with other fields.
        parts: its components.
        model: the Gaussians, changed in place.
        index: number of the field; field 0 is scored.
        kinds: kinds of the initial points (`PointCloud.kinds`).

    Attributes:
        logged: numbers logged in this iteration, by name.
        kinds: which Gaussians descend from points of a kind, `[N]` bool by its name.
    """

    def __init__(
        self,
        around: Surroundings,
        parts: Parts,
        model: GaussianModel,
        index: int,
        kinds: Mapping[str, Tensor] | None = None,
    ) -> None:
        self.index, self.parts, self.model = index, parts, model
        self.kinds = dict(kinds or {})
        self.optimizer = Adam(model)
        for part in parts.training:
            with part.at_work(lent=around.lent):
                part.component.begin_training(around.scene)
        self.parameters = ComponentParameters(parts)
        self.logged: dict[str, float] = {}
        self._around, self._settings = around, around.settings
        self._extent = around.scene.extent
        self._reader = model.reader()
        name = f"topology/{index}" if index else "topology"
        self._topology = torch.Generator().manual_seed(derived_seed(around.settings.seed, name))
        self._terms = {part.item.qualified_name for part in parts["regularizers"]}
        self._limit_logged = False
        self._reset = self._edited = False
        self._step: Step
        self._rendering: Rendering

    def begin(self, iteration: int, view: TrainingView) -> None:
        """Apply schedules and samplers."""
        settings, scene = self._settings, self._around.scene
        self.logged = {}
        degree = active_sh_degree(iteration, settings.sh_degree, settings.sh_every)
        sample = Sample(view, view.camera, view.image, scene.background, degree)
        self._lent = self._around.lent + of_kinds(self.kinds)
        self._lent += ReadOnlyGuard(models=(self.model,) if are_checked() else ())
        self._step = Step(
            iteration=iteration,
            iterations=settings.iterations,
            scene=scene,
            sample=sample,
            model=self._reader,
            extent=self._extent,
            priors=self.parts.priors,
            render=StepRenderer(self.model, sample),
            log=self._log_for_component,
            maps=self._around.maps,
            learning_rates=MappingProxyType(learning_rates(iteration, settings, self._extent)),
            kinds=MappingProxyType(self.kinds),
        )
        for part in self.parts.due("samplers", iteration):
            with part.at_work(iteration, self._lent):
                answer = part.component.sample(self._step, self._step.sample)
                self._take(check_sample(answer, self.model.count))

    def step_terms_alone(self) -> None:
        """Step the terms that have their own backward pass and optimizer step."""
        step = self._step
        for part in self.parts.due("regularizers", step.iteration):
            if part.item.host.step != "alone":
                continue
            self._forget_gradients()
            step.rendered(cache(lambda: step.render(step.sample.camera)))
            term, skip = term_alone(part, step, self._lent, self._log_number)
            if term.value.requires_grad:  # a term of zero may have none
                self._backward([term])
                self.optimizer.step(step.learning_rates, self._bands, skip=skip)
                self.parameters.step()
            step.rendered(None)

    def render(self) -> None:
        """Apply modifiers, and render the view of the iteration."""
        step, sample = self._step, self._step.sample
        self._forget_gradients()
        self._rendering = self.model.render(
            sample.camera,
            background=sample.background,
            sh_degree=sample.sh_degree,
            opacity_scale=self._opacity_scale(),
            smoothing=sample.smoothing,
            collect_statistics=bool(growing := self._growing(step.iteration)),
            collect_absolute=any(policy.absolute_gradients for policy in growing),
        )
        self._lent += of_rendering(self._rendering) + ReadOnlyGuard({"the target": sample.target})
        step.rendered(lambda: self._rendering)

    def seen_by_others(self) -> OtherField:
        """Return what losses and policies of other fields may read."""
        return OtherField(
            index=self.index,
            model=self._reader,
            rendering=self._rendering.detach(),
            render=StepRenderer(self.model, self._step.sample, gradients=False),
        )

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

    @property
    def lent(self) -> ReadOnlyGuard:
        """Data that components received in this iteration."""
        return self._lent

    def differentiate(self, others: tuple[OtherField, ...]) -> float:
        """Run the backward pass, and return the total loss."""
        step = self._step
        step.rendered(lambda: self._rendering, others)
        colors, log = self._colors(), self._log_number
        shown = colors[-1].after if colors else self._rendering
        photometric = photometric_term(self._settings, shown, step, self.model.device, log)
        terms = [photometric, *regularizing_terms(self.parts, step, self._lent, log)]
        return self._backward(terms, colors)

    def update_opacities(self) -> None:
        """Apply the opacity policies, in the order of the pipeline."""
        self._reset = False
        for part in self.parts.due("opacity", self._step.iteration):
            with part.at_work(self._step.iteration, self._lent):
                answer = part.component.update(self._step)
                update = check_opacity_update(answer, self.model.count)
            if update is not None:
                kept = update.opacities.float().clamp(OPACITY_MARGIN, 1 - OPACITY_MARGIN)
                self.model.write("opacity_logits", torch.logit(kept))
                self._reset |= update.reset_moments

    def change_topology(self) -> None:
        """Apply the densification policies."""
        self._edited = self._refine()

    def step_optimizer(self) -> None:
        """Step Adam for the Gaussians and the components' parameters."""
        rates = dict(self._step.learning_rates)
        if self._reset:
            # As in 3DGS, opacities that were reset take no step from the gradient before the reset.
            rates["opacity_logits"] = 0.0
        if not self._edited:
            # As in 3DGS: gradients of the Gaussians before an edit do not move those after it.
            self.optimizer.step(rates, self._bands)
        if self._reset:
            self.optimizer.reset_moments("opacity_logits")
        self.parameters.step()

    def perturb(self) -> None:
        """Add the offsets of perturbations to the parameters."""
        for part in self.parts.due("perturbations", self._step.iteration):
            with part.at_work(self._step.iteration, self._lent):
                offsets = check_offsets(part.component.offsets(self._step), self.model.read)
            with blame(part.item, self._step.iteration):
                for name, offset in offsets.items():
                    self.model.write(name, self.model.read(name) + offset)

    @property
    def _bands(self) -> int:
        """SH bands that Adam steps: those in use, and one that fades in."""
        return int(-(-self._step.sample.sh_degree // 1))

    def _take(self, sample: Sample) -> None:
        self._step = replace(self._step, sample=sample, render=StepRenderer(self.model, sample))

    def _forget_gradients(self) -> None:
        self.model.zero_gradients()
        self.parameters.zero_gradients()

    def _opacity_scale(self) -> Tensor | None:
        product: Tensor | None = None
        for part in self.parts.due("modifiers", self._step.iteration):
            with part.at_work(self._step.iteration, self._lent):
                answer = part.component.opacity_scale(self._step)
                scale = check_opacity_scale(answer, self.model.count)
            product = scale if product is None else product * scale
        return product

    def _growing(self, iteration: int) -> list[Densification[Any]]:
        """Return the policies that are due in this iteration or a later one."""
        parts = self.parts["densification"]
        return [p.component for p in parts if not p.item.schedule.over(iteration)]

    def _colors(self) -> list[Recolored]:
        """Return the colours before and after each appearance."""
        steps: list[Recolored] = []
        for part in self.parts.due("appearances", self._step.iteration):
            before = steps[-1].after if steps else self._rendering.rgb
            with part.at_work(self._step.iteration, self._lent):
                after = check_colors(part.component.colors(self._step, before), before.shape)
            steps.append(Recolored(part.item, before, after))
        return steps

    def _backward(self, terms: Sequence[Term], colors: Sequence[Recolored] = ()) -> float:
        """Run the backward pass of a loss; return the loss."""
        iteration = self._step.iteration
        return backward(
            terms,
            iteration,
            colors=colors,
            forget=self._forget_gradients,
            check=partial(self.parameters.check_gradients, iteration),
        )

    def _refine(self) -> bool:
        """Apply the densification policies; return whether the topology changed."""
        edited = False
        iteration = self._step.iteration
        for part in self.parts.due("densification", iteration):
            with part.at_work(iteration, self._lent):
                wanted = check_edit(part.component.refine(self._step), self.model.count)
            if wanted is None:
                continue
            last = iteration == self._settings.iterations
            edit = self._within_limit(without_growth(wanted) if last else wanted)
            if edit.empty:
                self.model.statistics.reset()
                continue
            count = self.model.count
            with blame(part.item, iteration):
                carried = apply_edit(self.model, self.optimizer, edit, self._topology)
            self._carry(carried, count)
            edited = True
        return edited

    def _within_limit(self, edit: Edit) -> Edit:
        if self._settings.max_gaussians is None:
            return edit
        edit, dropped = limited(
            edit, self._settings.max_gaussians, self.model.statistics.screen_gradient()
        )
        if dropped and not self._limit_logged:
            self._limit_logged = True
            _log.warning(
                "iteration %d: max_gaussians (%d) is reached; growth is cut from here on",
                self._step.iteration,
                self._settings.max_gaussians,
            )
        return edit

    def _carry(self, carried: Carried, count: int) -> None:
        """Reorder per-Gaussian data after an edit of `count` Gaussians."""
        self.kinds = {name: mask[carried.source] for name, mask in self.kinds.items()}
        self._step = replace(self._step, kinds=MappingProxyType(self.kinds))
        self.parts.carry(carried.source, carried.fresh, count, self._step.iteration)

    def _log_number(self, name: str, value: float) -> None:
        self.logged[name] = float(value)

    def _log_for_component(self, name: str, value: float) -> None:
        """Implement `Step.log`."""
        if name in HOST_NUMBERS or name in self._terms:
            raise PluginError(
                f"it logs {name!r}, a name that the host uses",
                fix="log it under another name",
            )
        self._log_number(name, value)

    def state(self, iteration: int) -> dict[str, Mapping[str, Tensor]]:
        """Return everything that the next iterations depend on, by kind."""
        gaussians = self.model.gaussians()
        return {
            "model": dict(vars(gaussians)),
            "optimizer": self.optimizer.state(),
            "statistics": {"screen": self.model.statistics.sums()},
            "topology": {"generator": self._topology.get_state()},
            "components": self.parts.state(iteration),
            "parameters": self.parameters.state(),
            "kinds": {name: mask.clone() for name, mask in self.kinds.items()},
        }

    def restore(self, part: Callable[[str], Mapping[str, Any]]) -> None:
        """Restore the result of `state`; the model must already hold the same Gaussians.

        Args:
            part: returns the tensors of one kind.
        """
        self.optimizer.restore(part("optimizer"))
        screen = part("statistics")["screen"]
        if screen.shape[1:] != (self.model.count,) or len(screen) not in (2, 3):
            raise RunError(
                f"the statistics of {self.model.count} Gaussians are {tuple(screen.shape)}"
            )
        self.model.statistics.restore(screen)
        self._topology.set_state(part("topology")["generator"])
        self.parts.restore(part("components"))
        self.parameters.restore(part("parameters"))
        self.kinds = dict(part("kinds"))
