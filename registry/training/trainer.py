"""The training loop. The order of one iteration lives here and nowhere else.

1. choose a training view          4. modifiers, render                       7. topology
2. schedules, samplers             5. photometric loss + due regularizers,    8. Adam
3. terms stepped alone                backward                                9. perturbations
                                   6. opacity policies

With several fields (`training.fields`) each stage is done for all of them before the next begins.
Progress, observers, evaluation and checkpoints come last: they run in whoever consumes `Trainer.run`,
which yields after every iteration.
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
    """What an iteration leaves behind for whoever consumes `Trainer.run`.

    Args:
        number: 1-based.
        loss: the total loss before the step; of the first field.
        gaussians: how many there are after it; in the first field.
        logged: numbers that the loop and the components recorded.
    """

    number: int
    loss: float
    gaussians: int
    logged: Mapping[str, float] = field(default_factory=dict)


class Trainer:
    """Trains Gaussians on a scene.

    Args:
        settings: of the loop.
        parts: the pipeline's components.
        scene: validated.
        model: the Gaussians, changed in place.
        maps: each training view's depth, as the initializer knows it (`PointCloud.maps`).
        kinds: of the points that the Gaussians start from (`PointCloud.kinds`).

    Attributes:
        iteration: the last one that is complete; 0 before the first.
        fields: what is trained in lock-step; the first holds `model` and is scored.
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
        """The first field's."""
        return self.fields[0].optimizer

    def run(self) -> Iterator[Iteration]:
        """Train to the last iteration, yielding after each; the last one is stepped too.

        Stop consuming to stop training: between two iterations everything is consistent.

        Raises:
            ExplainedError: a component failed or answered nonsense, or the loss is not finite. No
                step is taken then, and training cannot go on with these Gaussians.
        """
        self.state()  # what cannot be saved is told now, and not at the first checkpoint
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
        # The loss was waited for, so that this waits for nothing more.
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
        """Refuse to go on with Gaussians that the last step has left undefined."""
        for one in self.fields:
            try:
                one.optimizer.check_parameters()
            except GaussianError as error:
                error.fix += "; --check-plugins finds a component that writes into the Gaussians"
                raise

    def _others(self, one: Field) -> tuple[OtherField, ...]:
        return tuple(other.seen_by_others() for other in self.fields if other is not one)

    def _logged(self) -> dict[str, float]:
        """What the fields recorded; the names of all but the first begin with the field's number."""
        logged = dict(self.fields[0].logged)
        for one in self.fields[1:]:
            logged |= {f"field{one.index}/{name}": value for name, value in one.logged.items()}
        return logged

    def state(self) -> dict[str, Tensor]:
        """Everything that the next iterations depend on, by slashed names.

        Raises:
            ExplainedError: a component's state cannot be saved, or the next iteration would refuse the
                Gaussians.
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
            part: gives the tensors of `state` whose names begin with "<its argument>/"
                (`Checkpoint.part`). The model must already hold the checkpoint's Gaussians.
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
    """A trainer that goes on after a checkpoint.

    Args:
        model: holds the checkpoint's Gaussians.

    Raises:
        ExplainedError: the checkpoint holds something else than these parts need; or a component cannot
            take its state back.
    """
    trainer = Trainer(settings, parts, scene, model, maps_of(checkpoint.part("maps")))
    trainer.restore(checkpoint.iteration, checkpoint.part)
    return trainer


def _prefix(index: int) -> str:
    """In front of the names of a field's state; the first field's have none."""
    return f"field{index}/" if index else ""


def _below(
    part: Callable[[str], Mapping[str, Tensor]], prefix: str, kind: str
) -> Mapping[str, Tensor]:
    return part(f"{prefix}{kind}")


def maps_of(state: Mapping[str, Tensor]) -> dict[str, DepthMap]:
    """The initializer's depth maps that a checkpoint holds.

    Args:
        state: the tensors below "maps" of `Trainer.state`, by "<view>/<field>".
    """
    names = dict.fromkeys(name.rpartition("/")[0] for name in state)
    return {
        view: DepthMap(*(state[f"{view}/{key}"] for key in ("depth", "valid", "confidence")))
        for view in names
    }
