"""The training loop. The order of one iteration lives here and nowhere else.

1. choose a training view          4. photometric loss + due regularizers   7. topology
2. schedules                       5. backward                              8. Adam
3. modifiers, render               6. opacity policies

Observers (progress, logs, checkpoints, evaluation) come ninth: they run in whoever consumes
`Trainer.run`, which yields after every iteration.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Adam, Edit, ExplainedError, GaussianModel, apply_edit
from core_rasterizer import photometric_loss as photometric

from ..contract.answers import check_edit, check_loss, check_opacity_scale, check_opacity_update
from ..contract.scene import Scene
from ..contract.step import Step
from ..errors import RunError
from ..pipeline.blame import blame
from ..pipeline.parts import Parts
from ..pipeline.schedule import active_sh_degree
from ..pipeline.seeding import derived_seed
from ..pipeline.training_settings import TrainingSettings
from .learning_rates import learning_rates
from .step_rendering import StepRenderer, backward
from .topology_rules import limited
from .view_order import ViewOrder

OPACITY_MARGIN = 1e-6
"""Opacities are kept this far from 0 and 1, so that their logits stay finite."""

HEALTH_CHECK_EVERY = 100
"""Iterations between two looks for Gaussians that are not finite."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Iteration:
    """What an iteration leaves behind for observers.

    Args:
        number: 1-based.
        loss: the total loss before the step.
        gaussians: how many there are after it.
        logged: numbers that the loop and the components recorded.
    """

    number: int
    loss: float
    gaussians: int
    logged: Mapping[str, float]


class Trainer:
    """Trains Gaussians on a scene.

    Args:
        settings: of the loop.
        parts: the pipeline's components.
        scene: validated.
        model: the Gaussians, changed in place.

    Attributes:
        iteration: the last one that is complete; 0 before the first.
    """

    def __init__(
        self, settings: TrainingSettings, parts: Parts, scene: Scene, model: GaussianModel
    ) -> None:
        self.settings, self.parts, self.scene, self.model = settings, parts, scene, model
        self.optimizer = Adam(model)
        self.iteration = 0
        self._extent = scene.extent
        self._views = ViewOrder(len(scene.train), derived_seed(settings.seed, "views"))
        self._topology = torch.Generator().manual_seed(derived_seed(settings.seed, "topology"))
        self._logged: dict[str, float] = {}
        self._told_of_limit = False

    def run(self) -> Iterator[Iteration]:
        """Train to the last iteration, yielding after each; the last one is stepped too.

        Stop consuming to stop training: between two iterations everything is consistent.

        Raises:
            ExplainedError: a component failed or answered nonsense, or the loss is not finite. No
                step is taken then, and training cannot go on with these Gaussians.
        """
        while self.iteration < self.settings.iterations:
            loss = self._iterate(self.iteration + 1)
            self.iteration += 1
            yield Iteration(self.iteration, loss, self.model.count, self._logged)

    def _iterate(self, iteration: int) -> float:
        self._logged = {}
        view = self.scene.train[self._views.next()]
        degree = active_sh_degree(iteration, self.settings.sh_degree, self.settings.sh_every)
        step = Step(
            iteration=iteration,
            iterations=self.settings.iterations,
            scene=self.scene,
            view=view,
            rendering=None,
            model=self.model,
            extent=self._extent,
            priors=self.parts.priors,
            render=StepRenderer(self.model, self.scene, degree),
            log=self._log_number,
        )
        self.model.zero_gradients()
        step.rendering = self.model.render(
            view.camera,
            background=self.scene.background,
            sh_degree=degree,
            opacity_scale=self._opacity_scale(step),
            collect_statistics=self._statistics_wanted(iteration),
        )
        loss = self._loss(step)
        backward(loss, iteration)
        reset = self._update_opacities(step)
        edited = self._refine(step) | self._remove_broken(iteration)
        rates = learning_rates(iteration, self.settings, self._extent)
        if reset:
            # As in 3DGS, opacities that were reset take no step from the gradient before the reset.
            rates["opacity_logits"] = 0.0
        if not edited:
            # As in 3DGS: gradients of the Gaussians before an edit do not move those after it.
            self.optimizer.step(rates, degree)
        if reset:
            self.optimizer.reset_moments("opacity_logits")
        return float(loss.detach())

    def _opacity_scale(self, step: Step) -> Tensor | None:
        product: Tensor | None = None
        for part in self.parts.due("modifiers", step.iteration):
            with blame(part.item, step.iteration):
                scale = check_opacity_scale(part.component.opacity_scale(step), self.model.count)
            product = scale if product is None else product * scale
        return product

    def _statistics_wanted(self, iteration: int) -> bool:
        return any(not p.item.schedule.over(iteration) for p in self.parts["densification"])

    def _loss(self, step: Step) -> Tensor:
        assert step.rendering is not None
        try:
            loss = photometric(
                step.rendering.rgb,
                step.view.image,
                self.settings.ssim_weight,
                device=self.model.device,
            )
        except ExplainedError as error:
            raise RunError(
                error.what,
                where=f"iteration {step.iteration}, view {step.view.name!r}",
                fix="lower the learning rates; the last checkpoint, if any, is whole",
            ) from error
        self._log_number("photometric", float(loss.detach()))
        for part in self.parts.due("regularizers", step.iteration):
            with blame(part.item, step.iteration):
                term = check_loss(part.component.loss(step))
            self._log_number(part.item.qualified_name, float(term.detach()))
            loss = loss + part.item.host.weight * term
        return loss

    def _update_opacities(self, step: Step) -> bool:
        """Ask the opacity policies; whether moments are to be reset."""
        reset = False
        for part in self.parts.due("opacity", step.iteration):
            with blame(part.item, step.iteration):
                update = check_opacity_update(part.component.update(step), self.model.count)
            if update is not None:
                kept = update.opacities.float().clamp(OPACITY_MARGIN, 1 - OPACITY_MARGIN)
                self.model.write("opacity_logits", torch.logit(kept))
                reset |= update.reset_moments
        return reset

    def _refine(self, step: Step) -> bool:
        """Ask the densification policies; whether Gaussians came or went."""
        edited = False
        for part in self.parts.due("densification", step.iteration):
            with blame(part.item, step.iteration):
                wanted = check_edit(part.component.refine(step), self.model.count)
                if wanted is None:
                    continue
                edit = self._within_limit(wanted, step.iteration)
                if not any(m is not None and m.any() for m in (edit.clone, edit.split, edit.prune)):
                    self.model.reset_statistics()
                    continue
                self._apply(edit, step.iteration)
            edited = True
        return edited

    def _within_limit(self, edit: Edit, iteration: int) -> Edit:
        if self.settings.max_gaussians is None:
            return edit
        edit, dropped = limited(edit, self.settings.max_gaussians, self.model.screen_gradient())
        if dropped and not self._told_of_limit:
            self._told_of_limit = True
            _log.warning(
                "iteration %d: max_gaussians (%d) is reached; growth is cut from here on",
                iteration,
                self.settings.max_gaussians,
            )
        return edit

    def _remove_broken(self, iteration: int) -> bool:
        """Now and then, remove Gaussians that are not finite; whether there were any.

        The engine draws none of them, so nothing hurries.
        """
        if iteration % HEALTH_CHECK_EVERY and iteration < self.settings.iterations:
            return False
        broken = self.model.not_finite()
        number = int(broken.sum())
        if not number:
            return False
        if number == self.model.count:
            raise RunError(
                f"all {number} Gaussians have become something that is not finite",
                where=f"iteration {iteration}",
                fix="lower the learning rates; the last checkpoint, if any, is whole",
            )
        _log.warning("iteration %d: removing %d Gaussians that are not finite", iteration, number)
        self._log_number("removed_not_finite", number)
        self._apply(Edit(prune=broken), iteration)
        return True

    def _apply(self, edit: Edit, iteration: int) -> None:
        carried = apply_edit(self.model, self.optimizer, edit, self._topology)
        self.parts.carry(carried.source, carried.fresh, iteration)

    def _log_number(self, name: str, value: float) -> None:
        self._logged[name] = float(value)

    def state(self) -> dict[str, Tensor]:
        """Everything that the next iterations depend on, by slashed names."""
        gaussians = self.model.gaussians()
        parts: dict[str, Mapping[str, Tensor]] = {
            "model": {f.name: getattr(gaussians, f.name) for f in fields(gaussians)},
            "optimizer": self.optimizer.state(),
            "statistics": {"screen": self.model.statistics()},
            "views": self._views.state(),
            "topology": {"generator": self._topology.get_state()},
            "components": self.parts.state(self.iteration),
        }
        return {f"{p}/{name}": value for p, state in parts.items() for name, value in state.items()}

    def restore(self, iteration: int, part: Any) -> None:
        """Continue after `iteration`.

        Args:
            part: gives the tensors of `state` whose names begin with "<its argument>/"
                (`Checkpoint.part`). The model must already hold the checkpoint's Gaussians.
        """
        self.iteration = iteration
        self.optimizer.restore(part("optimizer"))
        self.model.restore_statistics(part("statistics")["screen"])
        self._views.restore(part("views"))
        self._topology.set_state(part("topology")["generator"])
        self.parts.restore(part("components"))
