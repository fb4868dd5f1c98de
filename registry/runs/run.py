"""A run: what a pipeline has made of a scene, while it trains, when it is done, or read from its folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, Rendering, save_ply

from ..contract.scene import Scene
from ..errors import RunError
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline
from ..training.checkpoint import CHECKPOINT, Checkpoint, save_checkpoint
from ..training.threads import one_torch_thread
from .evaluation import Scores, clamped_render, evaluate, quick
from .folder import RunFolder
from .origin.inputs import input_digests
from .origin.provenance import provenance
from .results import finish

Floats = NDArray[np.float32]


class Picture(NamedTuple):
    """A rendered camera as numpy arrays, float32.

    Args:
        rgb: `[H, W, 3]` in [0, 1].
        depth: `[H, W]` z-depth in world units, blended: divide by `alpha` where that is not 0.
        alpha: `[H, W]` in [0, 1], how much of the light the Gaussians stop.
    """

    rgb: Floats
    depth: Floats
    alpha: Floats


@dataclass
class Stages:
    """Seconds of wall-clock time that each stage took; after a resume, the loading done last counts.

    `outputs` is what exporters and reports take. Imports are nobody's: they come before a run begins.
    """

    scene: float = 0.0
    initialization: float = 0.0
    training: float = 0.0
    evaluation: float = 0.0
    outputs: float = 0.0

    def rounded(self) -> dict[str, float]:
        """By name, to milliseconds."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


@dataclass(eq=False)
class Run:
    """A pipeline, its scene, and the Gaussians that it has made of it so far.

    Args:
        pipeline: what was trained.
        parts: its components at work.
        scene: the photographs and cameras.
        model: the Gaussians.
        checkpoint: gives everything that training needs to go on from here.
        iteration: the last one that is complete.
        initialization: the facts that the initializer reports.
        pictures: what it drew, `[H, W, 3]` in [0, 1] by name.
        seconds: what each stage took.
        metrics: what metrics.jsonl holds, line by line; of a run read from a folder, nothing.
        folder: where the run is kept; None: in memory only.
        changed: inputs that are not those that the run began with, and were accepted.
        identity: what tells its folder from those of other runs; "" without a folder.
        kept: the iteration of the newest checkpoint in the folder.
    """

    pipeline: Pipeline
    parts: Parts
    scene: Scene
    model: GaussianModel
    checkpoint: Callable[[], Checkpoint]
    iteration: int = 0
    initialization: dict[str, Any] = field(default_factory=dict)
    pictures: dict[str, Tensor] = field(default_factory=dict)
    seconds: Stages = field(default_factory=Stages)
    metrics: list[dict[str, Any]] = field(default_factory=list)
    folder: RunFolder | None = None
    changed: tuple[str, ...] = ()
    identity: str = ""
    kept: int | None = None
    _scores: tuple[int, dict[str, Scores]] | None = None

    @cached_property
    def pipeline_text(self) -> str:
        """The pipeline as YAML, every default written out."""
        return self.pipeline.to_yaml()

    @property
    def finished(self) -> bool:
        """Whether the last iteration of the pipeline is complete."""
        return self.iteration >= self.pipeline.training.iterations

    @property
    def hash(self) -> str:
        """SHA-256 of the Gaussians, equal for equal bits."""
        return self.model.digest()

    @property
    def kinds(self) -> dict[str, Tensor]:
        """Which Gaussians descend from initial points of a kind, `[N]` bool by its name.

        Empty if the initializer tells no kinds apart (`PointCloud.kinds`).
        """
        return self.checkpoint().part("kinds")

    @property
    def scores(self) -> dict[str, Scores]:
        """By split, "test" and "train"; measured when first asked for: `scores["test"].mean["psnr"]`."""
        if self._scores is None or self._scores[0] != self.iteration:
            return self.evaluate()
        return self._scores[1]

    def evaluate(self, pictures: Path | None = None) -> dict[str, Scores]:
        """Render and score all views anew.

        Args:
            pictures: a folder for the test views' pictures; None draws none.
        """
        begin = monotonic()
        scene, metrics = self.scene, self.parts["metrics"]
        with one_torch_thread():
            scores = {
                "test": evaluate(self.model, scene, scene.test, metrics, pictures),
                "train": evaluate(self.model, scene, scene.train, quick(metrics)),
            }
        self.seconds.evaluation = monotonic() - begin
        self._scores = (self.iteration, scores)
        return scores

    def rendering(self, camera: Camera) -> Rendering:
        """A camera on the scene's background as tensors, without gradients, colours in [0, 1]."""
        return clamped_render(self.model, camera, self.scene.background)

    def render(self, camera: Camera) -> Picture:
        """A camera on the scene's background as numpy arrays."""
        return as_arrays(self.rendering(camera))

    def export(self, path: str | os.PathLike[str]) -> Path:
        """Write the Gaussians as a PLY file that viewers of 3D Gaussian Splatting read."""
        file = Path(path).expanduser()
        save_ply(self.model.gaussians(), file)
        return file

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write the run folder that training with `out=folder` would have left, and keep the run there.

        Of its checkpoints it has the newest alone. A run that is not finished is saved too, and can be
        resumed.

        Raises:
            RunError: the run is kept in a folder already, or this one has content.
        """
        if self.folder is not None:
            raise RunError(
                "the run is kept in a folder already",
                where=str(self.folder.path),
                fix="copy that folder; a run folder can be moved",
            )
        self.keep_in(Path(folder).expanduser())
        kept_in = self.folder_or_refuse()
        with kept_in.to_itself():
            for line in self.metrics:
                kept_in.append_metrics(line)
            if self.finished:
                finish(self)
        return kept_in.path

    def keep_in(self, path: Path) -> None:
        """Create the run folder, with a checkpoint of where the run is; the rest goes there too.

        Raises:
            RunError: the folder has content, is a file, or cannot be written.
        """
        origin = provenance(self.pipeline, self.model.device)
        self.identity = origin["run"]

        def fill(folder: RunFolder) -> None:
            folder.write_initialization(self.initialization, self.pictures)
            save_checkpoint(self.checkpoint(), folder.folder(CHECKPOINT))

        folder = RunFolder(path)
        digests = input_digests(self.scene, self.pipeline)
        folder.create(self.pipeline_text, origin, digests, fill)
        self.folder, self.kept = folder, self.iteration

    def keep_changes(self) -> None:
        """Write down which inputs have changed, once something is made from them."""
        if self.changed and self.folder is not None:
            earlier = self.folder.inputs()[1]
            names = dict.fromkeys([*earlier, *self.changed])
            self.folder.write_inputs(input_digests(self.scene, self.pipeline), [*names])

    def add_metrics(self, line: dict[str, Any]) -> None:
        """Remember a line of metrics, in the folder too if there is one."""
        self.metrics.append(line)
        if self.folder is not None:
            self.folder.append_metrics(line)

    def save_checkpoint(self) -> None:
        """Keep a checkpoint in the folder, if there is one, unless its newest is of this iteration."""
        if self.folder is not None and self.kept != self.iteration:
            save_checkpoint(self.checkpoint(), self.folder.folder(CHECKPOINT))
            self.kept = self.iteration

    def folder_or_refuse(self) -> RunFolder:
        """The folder.

        Raises:
            RunError: the run is in memory only.
        """
        if self.folder is None:
            raise RunError("the run is in memory only", fix="save it first: run.save(folder)")
        return self.folder


def as_arrays(rendering: Rendering) -> Picture:
    """A rendering as numpy arrays."""
    return Picture(*(_array(t) for t in (rendering.rgb, rendering.depth, rendering.alpha)))


def _array(tensor: Tensor) -> Floats:
    values: Floats = tensor.detach().to("cpu", torch.float32).numpy()
    return values
