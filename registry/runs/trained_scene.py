"""What was trained: a pipeline, a scene and the Gaussians, with their scores and renders."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Any

from torch import Tensor

from core_rasterizer import Camera, GaussianReader, Model, Rendering, save_ply

from ..calls.copies import copied
from ..calls.process_state import one_torch_thread
from ..confidence import Confidence, Trained
from ..contract.component import Component
from ..contract.components import ViewMetric
from ..contract.frame import Frame
from ..contract.scene import Scene
from ..discovery import CONFIDENCE, Plugins
from ..pipeline.parts import Parts, build_part
from ..pipeline.pipeline import Pipeline
from ..pipeline.protocols import scored
from ..pipeline.single_item import single_item
from ..toolkit.progress import tracked
from ..training.checkpoint import Checkpoint
from ..training.gradients import FEATURES
from ..training.placed import PlacedConfidence, PlacedGaussians
from ..training.prior_masks import with_prior_masks
from ..training.trainer import maps_of
from .evaluation import Picture, Scores, as_arrays, evaluate, quick


@dataclass
class Stages:
    """Wall-clock seconds of each stage; `outputs` are exporters and reports, imports do not count.

    After a resume, `scene` is the time of the last loading.
    """

    scene: float = 0.0
    initialization: float = 0.0
    training: float = 0.0
    evaluation: float = 0.0
    outputs: float = 0.0

    def rounded(self) -> dict[str, float]:
        """Return seconds by name, to milliseconds."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


@dataclass(eq=False)
class TrainedScene:
    """A pipeline, its scene, and the Gaussians trained so far.

    Args:
        pipeline: the pipeline that trains.
        parts: its components.
        scene: the training and test views, in the file's coordinates.
        engine_model: the Gaussians on the device, in the frame of training.
        frame: the frame of training.
        checkpoint: returns everything that training needs to continue from here.
        iteration: the last complete iteration.
        initialization: facts reported by the initializer.
        pictures: pictures drawn by the initializer, `[H, W, 3]` in [0, 1] by name.
        seconds: wall-clock time of each stage.
        metrics: lines of metrics.jsonl; empty for a run read from a folder.
        interrupted: whether Ctrl-C or SIGTERM stopped the training.
        recoveries: see `results.Recovery`.
        edits: see `results.HandEdit`.
    """

    pipeline: Pipeline
    parts: Parts
    scene: Scene
    engine_model: Model
    frame: Frame
    checkpoint: Callable[[], Checkpoint]
    iteration: int = 0
    initialization: dict[str, Any] = field(default_factory=dict)
    pictures: dict[str, Tensor] = field(default_factory=dict)
    seconds: Stages = field(default_factory=Stages)
    metrics: list[dict[str, Any]] = field(default_factory=list)
    interrupted: bool = False
    recoveries: list[dict[str, Any]] = field(default_factory=list)
    edits: list[dict[str, Any]] = field(default_factory=list)
    _scores: tuple[int, dict[str, Scores]] | None = None

    @cached_property
    def pipeline_text(self) -> str:
        """The pipeline as YAML, with every default."""
        return self.pipeline.to_yaml()

    @property
    def model(self) -> PlacedGaussians:
        """The Gaussians in the file's coordinates."""
        return PlacedGaussians(self.engine_model, self.frame)

    @cached_property
    def framed(self) -> Scene:
        """The scene in the frame of training."""
        return self.scene.in_frame(self.frame)

    @cached_property
    def trained_on(self) -> Scene:
        """`framed` with the masks of the pipeline's priors (`MaskPrior`), as training sees it."""
        return with_prior_masks(self.framed, self.parts)

    @property
    def finished(self) -> bool:
        """Whether the last iteration of the pipeline is complete."""
        return self.iteration >= self.pipeline.training.iterations

    @property
    def hash(self) -> str:
        """SHA-256 of the Gaussians and their features, equal for equal bits."""
        return self.exported.digest()

    @property
    def kinds(self) -> dict[str, Tensor]:
        """Which Gaussians descend from initial points of a kind, `[N]` bool by its name.

        Empty if the initializer does not distinguish kinds (`PointCloud.kinds`).
        """
        return self.checkpoint().part("kinds")

    @property
    def features(self) -> dict[str, Tensor]:
        """Numbers per Gaussian that components train or keep, `[N]` by `NAME_CHANNEL`."""
        offered = [item.offer.component.features for item in self.pipeline]
        if not self.pipeline.missing and set(offered) == {Component.features}:
            return {}
        saved = self.checkpoint().part(f"parameters/{FEATURES}")
        return {
            f"{name.removesuffix('/value')}_{channel}": column
            for name, values in sorted(saved.items())
            if name.endswith("/value")
            for channel, column in enumerate(values.unbind(dim=1))
        }

    @property
    def exported(self) -> PlacedGaussians:
        """The Gaussians in the file's coordinates, with their features, for exporters."""
        return PlacedGaussians(self.engine_model, self.frame, self.features)

    @one_torch_thread()
    def confidence(self, name: str, changes: Sequence[str] = ()) -> Confidence:
        """Return the confidence in renders of cameras in the file's coordinates.

        Args:
            name: an installed estimator, for example "calibrated", "coverage" or "fisher".
            changes: `key=value`, settings of the estimator.
        """
        return PlacedConfidence(self._confidence(name, changes), self.frame)

    def _confidence(self, name: str, changes: Sequence[str] = ()) -> Confidence:
        item = single_item(Plugins().find(CONFIDENCE, name), changes)
        part = build_part(item, self.pipeline.training.seed, self.engine_model.engine)
        answer: Confidence = part.call(self.trained)
        return answer

    @property
    def trained(self) -> Trained:
        """The Gaussians and what they were trained on, in the frame of training; of the inputs, copies."""
        maps = maps_of(self.checkpoint().part("maps"))
        inputs = copied((self.trained_on.for_training(), maps, self.kinds))
        return Trained(GaussianReader(self.engine_model), *inputs, self._confidence)

    @property
    def scores(self) -> dict[str, Scores]:
        """Scores by split, "test" and "train", computed on first use: `scores["test"].mean["psnr"]`."""
        if self._scores is None or self._scores[0] != self.iteration:
            return self.evaluate()
        return self._scores[1]

    @one_torch_thread()
    def evaluate(self, pictures: Path | None = None) -> dict[str, Scores]:
        """Render and score views (`scored`); draw the test views, or if none the others, into a folder."""
        begin = monotonic()
        scene, metrics = self.framed, self.parts["metrics"]
        of_train = None if scene.test else pictures
        begun = ViewMetric.begin_scoring
        if asking := [p for p in metrics if type(p.component).begin_scoring is not begun]:
            trained = self.trained
            for part in asking:
                with part.at_work():
                    part.component.begin_scoring(trained)
        views = tracked([*scene.test, *scored(scene.train, scene.test)], "scoring")
        test = islice(views, len(scene.test))
        scores = {
            "test": evaluate(self.engine_model, scene, test, metrics, pictures, repeat=True),
            "train": evaluate(self.engine_model, scene, views, quick(metrics), of_train),
        }
        self.seconds.evaluation = monotonic() - begin
        self._scores = (self.iteration, scores)
        return scores

    def rendering(self, camera: Camera) -> Rendering:
        """Render a camera of the file on the scene's background, without gradients, colours in [0, 1]."""
        return self.model.render(camera, background=self.scene.background)

    def render(self, camera: Camera) -> Picture:
        """Render a camera on the scene's background as numpy arrays."""
        return as_arrays(self.rendering(camera))

    def export(self, path: str | os.PathLike[str]) -> Path:
        """Write the Gaussians as a PLY file for viewers of 3D Gaussian Splatting."""
        file = Path(path).expanduser()
        save_ply(self.model.gaussians(), file, self.features)
        return file
