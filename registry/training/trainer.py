"""The training loop. Only this module defines the order of one iteration.

1. choose a training view          4. modifiers, render                       7. topology
2. schedules, samplers             5. photometric loss + due regularizers,    8. Adam
3. terms stepped alone                backward                                9. perturbations
                                   6. opacity policies

With several fields (`training.fields`) each stage runs for all of them before the next. `Trainer.run` yields
after every iteration; its caller then handles progress, observers, evaluation and checkpoints.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

from torch import Tensor

from core_rasterizer import Adam, GaussianError, GaussianModel, Gaussians

from ..contract.maps import DepthMap
from ..contract.scene import Scene
from ..contract.step import OtherField
from ..pipeline.parts import Parts
from ..pipeline.seeding import derived_seed
from ..pipeline.training_settings import TrainingSettings
from .checkpoint import Checkpoint
from .field import Field, Surroundings
from .guard import in_iteration
from .initial_model import new_model
from .view_order import ViewOrder

_log = logging.getLogger("stereogs")


@dataclass(frozen=True)
class Iteration:
    """Result of an iteration.

    Args:
        number: 1-based.
        loss: total loss of the first field before the step.
        gaussians: number of Gaussians in the first field after the step.
        logged: numbers logged by the loop and the components.
    """

    number: int
    loss: float
    gaussians: int
    logged: Mapping[str, float] = field(default_factory=dict)


class Trainer:
    """Trains Gaussians on a scene.

    Args:
        settings: settings of the loop.
        parts: components of the pipeline.
        scene: validated.
        model: the Gaussians, changed in place.
        maps: depth maps of the training views from the initializer (`PointCloud.maps`).
        kinds: kinds of the initial points (`PointCloud.kinds`).

    Attributes:
        iteration: the last complete iteration; 0 before the first.
        fields: fields of Gaussians trained in lock-step; the first holds `model` and is scored.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        parts: Parts,
        scene: Scene,
        model: GaussianModel,
        maps: Mapping[str, DepthMap] | None = None,
        kinds: Mapping[str, Tensor] | None = None,
    ) -> None:
        self.settings, self.parts, self.scene, self.model = settings, parts, scene, model
        self.iteration = 0
        self._around = Surroundings(settings, scene.for_training(), maps or {})
        self.fields = [Field(self._around, parts, model, 0, kinds)]
        for index in range(1, settings.fields):
            twin = new_model(model.gaussians(), settings, model.device)
            self.fields.append(Field(self._around, parts.for_field(index), twin, index, kinds))
        for part in parts:
            if part.item.point.scheduled and not part.item.schedule.ever_due(settings.iterations):
                _log.warning(
                    "%s at %s is never due in %d iterations",
                    part.item.offer,
                    part.item.place,
                    settings.iterations,
                )
        self._views = ViewOrder(len(scene.train), derived_seed(settings.seed, "views"))

    @property
    def optimizer(self) -> Adam:
        """Optimizer of the first field."""
        return self.fields[0].optimizer

    def run(self) -> Iterator[Iteration]:
        """Train to the last iteration, and yield after each.

        The state is consistent between two iterations, so the caller may stop iterating.

        Raises:
            ExplainedError: a component failed or returned an invalid answer, or the loss is not finite.
                Training cannot continue with these Gaussians.
        """
        self.state()  # reports state that cannot be saved before the first checkpoint
        while self.iteration < self.settings.iterations:
            with in_iteration(self.iteration + 1):
                loss = self._iterate(self.iteration + 1)
            self.iteration += 1
            yield Iteration(self.iteration, loss, self.model.count, self._logged())

    def _iterate(self, iteration: int) -> float:
        view = self._around.scene.train[self._views.next()]
        for one in self.fields:
            one.begin(iteration, view)
        for one in self.fields:
            one.step_terms_alone()
        for one in self.fields:
            one.render()
        losses = [one.differentiate(self._others(one)) for one in self.fields]
        # The device is idle after reading the loss, so this check does not wait.
        self._check_parameters()
        for one in self.fields:
            one.update_opacities()
        for one in self.fields:
            one.change_topology()
        for one in self.fields:
            one.step_optimizer()
        for one in self.fields:
            one.perturb()
        if iteration == self.settings.iterations:
            self._check_parameters()
        return losses[0]

    def _check_parameters(self) -> None:
        """Refuse Gaussians that the last step made undefined."""
        for one in self.fields:
            try:
                one.optimizer.check_parameters()
            except GaussianError as error:
                error.fix += "; --check-plugins finds a component that writes into the Gaussians"
                raise

    def _others(self, one: Field) -> tuple[OtherField, ...]:
        return tuple(other.seen_by_others() for other in self.fields if other is not one)

    def _logged(self) -> dict[str, float]:
        """Return the logged numbers of all fields; names of all but the first begin with the field."""
        logged = dict(self.fields[0].logged)
        for one in self.fields[1:]:
            logged |= {f"field{one.index}/{name}": value for name, value in one.logged.items()}
        return logged

    def state(self) -> dict[str, Tensor]:
        """Return everything that the next iterations depend on, by slash-separated names.

        Raises:
            ExplainedError: the state of a component cannot be saved, or the Gaussians are not finite.
        """
        with in_iteration(self.iteration + 1):
            self._check_parameters()
        kinds: dict[str, Mapping[str, Tensor]] = {"views": self._views.state()}
        for one in self.fields:
            state = one.state(self.iteration)
            kinds |= {f"{_prefix(one.index)}{kind}": values for kind, values in state.items()}
        for name, known in self._around.maps.items():
            kinds[f"maps/{name}"] = dict(vars(known))
        return {f"{k}/{name}": value for k, state in kinds.items() for name, value in state.items()}

    def restore(self, iteration: int, part: Callable[[str], Mapping[str, Tensor]]) -> None:
        """Continue after `iteration`.

        Args:
            part: returns the tensors of `state` below a prefix (`Checkpoint.part`). The model must already
                hold the Gaussians of the checkpoint.
        """
        self.iteration = iteration
        self._views.restore(part("views"))
        for index, one in enumerate(self.fields):
            prefix = _prefix(index)
            if index:
                gaussians = Gaussians(**part(f"{prefix}model"))
                model = new_model(gaussians, self.settings, self.model.device)
                one = self.fields[index] = Field(self._around, one.parts, model, index)
            one.restore(partial(_below, part, prefix))


def resumed(
    checkpoint: Checkpoint,
    settings: TrainingSettings,
    parts: Parts,
    scene: Scene,
    model: GaussianModel,
) -> Trainer:
    """Return a trainer that continues after a checkpoint.

    Args:
        model: holds the Gaussians of the checkpoint.

    Raises:
        ExplainedError: the checkpoint does not match the parts, or a component cannot restore its state.
    """
    trainer = Trainer(settings, parts, scene, model, maps_of(checkpoint.part("maps")))
    trainer.restore(checkpoint.iteration, checkpoint.part)
    return trainer


def _prefix(index: int) -> str:
    """Return the prefix of a field's state, empty for the first field."""
    return f"field{index}/" if index else ""


def _below(
    part: Callable[[str], Mapping[str, Tensor]], prefix: str, kind: str
) -> Mapping[str, Tensor]:
    return part(f"{prefix}{kind}")


def maps_of(state: Mapping[str, Tensor]) -> dict[str, DepthMap]:
    """Return the initializer's depth maps from a checkpoint.

    Args:
        state: the tensors below "maps" in `Trainer.state`, by "<view>/<field>".
    """
    names = dict.fromkeys(name.rpartition("/")[0] for name in state)
    return {
        view: DepthMap(*(state[f"{view}/{key}"] for key in ("depth", "valid", "confidence")))
        for view in names
    }
