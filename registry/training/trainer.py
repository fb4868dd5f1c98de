"""The training loop.

`Trainer._iterate` defines the order of one iteration: each stage of `Field` runs for all fields
(`training.fields`) before the next. `Trainer.run` yields after every iteration; its caller then handles
progress, observers, evaluation and checkpoints.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from core_rasterizer import GaussianError, Gaussians, Model

from ..contract.scene import DepthMap, Scene
from ..errors import RunError
from ..pipeline.parts import Parts, derived_seed
from ..pipeline.training_settings import TrainingSettings
from .checkpoint import FRAME, Checkpoint
from .field import Field
from .gradients import in_iteration
from .initial_model import new_model

_FIRST_SH_DEGREE = "first_sh_degree"
"""Name of the tensor in checkpoints of trainings whose initial points have SH bands."""


@dataclass(frozen=True)
class Iteration:
    """Result of an iteration.

    Args:
        number: 1-based.
        loss: total loss of the first field before the step.
        gaussians: number of Gaussians in the first field after the step.
        logged: numbers logged by the loop and the components; those of other fields begin with "field1/" etc.
    """

    number: int
    loss: float
    gaussians: int
    logged: Mapping[str, float] = dataclasses.field(default_factory=dict)


class Trainer:
    """Trains Gaussians on a scene.

    Args:
        settings: settings of the loop.
        parts: components of the pipeline.
        scene: validated.
        model: the Gaussians, changed in place.
        maps: depth maps of the training views from the initializer (`PointCloud.maps`).
        kinds: kinds of the initial points (`PointCloud.kinds`).
        checkpoint: to continue after; the model must hold its Gaussians. Then `maps` and `kinds` are its.
        first_sh_degree: SH bands of the initial points (`PointCloud.sh`), or the checkpoint's.

    Attributes:
        iteration: the last complete iteration; 0 before the first.
        fields: fields of Gaussians trained in lock-step; the first holds `model` and is scored.

    Raises:
        ExplainedError: the checkpoint does not match the parts, or a component cannot restore its state.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        parts: Parts,
        scene: Scene,
        model: Model,
        maps: Mapping[str, DepthMap] | None = None,
        kinds: Mapping[str, Tensor] | None = None,
        checkpoint: Checkpoint | None = None,
        first_sh_degree: int = 0,
    ) -> None:
        self.settings, self.parts, self.scene, self.model = settings, parts, scene, model
        self.iteration = 0
        self._maps, known = maps or {}, scene.for_training()
        if checkpoint is not None:
            self._maps = maps_of(checkpoint.part("maps"))
            first_sh_degree = int(checkpoint.tensors.get(_FIRST_SH_DEGREE, torch.tensor(0)))
        self._first_sh_degree = first_sh_degree
        inputs = settings, known, self._maps
        self.fields = [Field(*inputs, parts, model, 0, kinds, first_sh_degree)]
        for index in range(1, settings.fields):
            gaussians = model.gaussians()
            if checkpoint is not None:
                gaussians = Gaussians(**checkpoint.part(f"field{index}/model"))
            twin, its = new_model(gaussians, settings, model.engine), parts.for_field(index)
            self.fields.append(Field(*inputs, its, twin, index, kinds, first_sh_degree))
        self._train = known.train
        self._views = ViewOrder(len(scene.train), derived_seed(settings.seed, "views"))
        if checkpoint is not None:
            self.iteration = checkpoint.iteration
            self._views.restore(checkpoint.part("views"))
            for field in self.fields:
                field.restore(checkpoint.part)

    def run(self) -> Iterator[Iteration]:
        """Train to the last iteration, and yield after each; the caller may stop iterating.

        Raises:
            ExplainedError: a component failed or returned an invalid answer, or the loss is not finite.
                Training cannot continue with these Gaussians.
        """
        self.state()  # reports state that cannot be saved before the first checkpoint
        while self.iteration < self.settings.iterations:
            with in_iteration(self.iteration + 1):
                loss = self._iterate(self.iteration + 1)
            self.iteration += 1
            logged = {
                f"{field.prefix}{name}": value
                for field in self.fields
                for name, value in field.logged.items()
            }
            yield Iteration(self.iteration, loss, self.model.count, logged)

    def _iterate(self, iteration: int) -> float:
        view = self._train[self._views.next()]
        for field in self.fields:
            field.begin(iteration, view)
        for stage in (Field.step_terms_alone, Field.render):
            for field in self.fields:
                stage(field)
        losses = [field.differentiate(self.fields) for field in self.fields]
        # The device is idle after reading the loss, so this check does not wait.
        self._check_parameters()
        for stage in (
            Field.update_opacities,
            Field.change_topology,
            Field.step_optimizer,
            Field.perturb,
        ):
            for field in self.fields:
                stage(field)
        if iteration == self.settings.iterations:
            self._check_parameters()
        return losses[0]

    def _check_parameters(self) -> None:
        """Refuse Gaussians that the last step made undefined."""
        for field in self.fields:
            try:
                field.optimizer.check_parameters()
            except GaussianError as error:
                error.fix += "; --check-plugins finds a component that writes into the Gaussians"
                raise

    def state(self) -> dict[str, Tensor]:
        """Return everything that the next iterations depend on, by slash-separated names.

        Raises:
            ExplainedError: the state of a component cannot be saved, or the Gaussians are not finite.
        """
        with in_iteration(self.iteration + 1):
            self._check_parameters()
        state = {f"views/{name}": value for name, value in self._views.state().items()}
        frame = self.scene.frame
        state[FRAME] = torch.tensor([*frame.center, frame.unit], dtype=torch.float64)
        if self._first_sh_degree:
            state[_FIRST_SH_DEGREE] = torch.tensor(self._first_sh_degree)
        for field in self.fields:
            state |= field.state(self.iteration)
        for view, known in self._maps.items():
            state |= {f"maps/{view}/{name}": value for name, value in vars(known).items()}
        return state


class ViewOrder:
    """Shuffled order of `count` training views; draws every view once before any is repeated (3DGS)."""

    def __init__(self, count: int, seed: int) -> None:
        self._count = count
        self._generator = torch.Generator().manual_seed(seed)
        self._left: list[int] = []

    def next(self) -> int:
        """Return the index of the next view."""
        if not self._left:
            self._left = torch.randperm(self._count, generator=self._generator).tolist()
        return self._left.pop(0)

    def state(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint."""
        left = torch.tensor(self._left, dtype=torch.int64)
        return {"generator": self._generator.get_state(), "left": left}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore the result of `state`; refuse views that do not exist."""
        left = state["left"].tolist()
        if state["left"].ndim != 1 or not set(left) <= set(range(self._count)):
            raise RunError(f"the remaining views, {left}, are not among the {self._count} views")
        self._generator.set_state(state["generator"])
        self._left = left


def maps_of(state: Mapping[str, Tensor]) -> dict[str, DepthMap]:
    """Return the initializer's depth maps from the tensors below "maps" in `Trainer.state`."""
    names = dict.fromkeys(name.rpartition("/")[0] for name in state)
    return {
        view: DepthMap(*(state[f"{view}/{key}"] for key in ("depth", "valid", "confidence")))
        for view in names
    }
