"""Small components of every kind, for tests of the host."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

import registry as r
from core_rasterizer import Edit, GaussianReader
from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
from registry.testing import tiny_scene


class ToySceneSettings(r.Settings):
    path: Path = Path("nowhere")
    """Not read."""
    test_views: int = 1
    colors: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: Literal["good", "missing", "crash"] = "good"
    strict: bool = False
    nested: r.Settings = r.Settings()


class ToyScene(r.SceneLoader[ToySceneSettings]):
    """Two training views and one test view."""

    def load(self) -> r.Scene:
        if self.settings.mode == "missing":
            raise r.SceneError("no photographs", where="folder/x", fix="add some")
        if self.settings.mode == "crash":
            raise ZeroDivisionError("boom")
        scene = tiny_scene()
        return replace(scene, test=scene.test[: self.settings.test_views])


class ToyPointsSettings(r.Settings):
    count: int | None = None
    kinds: bool = False
    """Separate points before z = 3 from those behind."""


class ToyPoints(r.Initializer[ToyPointsSettings]):
    def initialize(self, scene: r.TrainingScene, priors: Mapping[str, Any]) -> r.PointCloud:
        points = scene.points
        if points is None:
            raise r.SceneError("the scene has no points", where=scene.name, fix="use another one")
        end = self.settings.count
        near = scene.frame.points_in_file(points.positions[:end])[:, 2] < 3
        kinds = {"near": near, "far": ~near} if self.settings.kinds else {}
        return r.PointCloud(points.positions[:end], points.colors[:end], kinds=kinds)


class ToyPrior(r.Prior[r.Settings]):
    capability = "monocular_depth"


class ToyTermSettings(r.Settings):
    target: float = 0.5
    fault: Literal["none", "nan", "shape", "gradient", "crash", "backward"] = "none"


class _Refuse(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        return value.clone()

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        raise ValueError("no way back")


class ToyTerm(r.Regularizer[ToyTermSettings]):
    """Pulls alpha towards a target; counts calls for each Gaussian."""

    def __init__(self, settings: ToyTermSettings, context: r.Context) -> None:
        super().__init__(settings, context)
        self.calls = torch.zeros(0)

    def loss(self, step: r.Step) -> Tensor:
        if not len(self.calls):
            self.calls = torch.zeros(step.model.count)
        self.calls += 1
        step.log("calls", float(self.calls.max()))
        alpha = step.rendering.alpha
        noise = torch.rand((), generator=self.generator)
        loss = (alpha - self.settings.target * noise).square().mean()
        fault = self.settings.fault
        if fault == "crash":
            raise ZeroDivisionError("boom")
        if fault == "nan":
            return loss * float("nan")
        if fault == "shape":
            return alpha
        if fault == "gradient":
            return (alpha * 0).sum().sqrt()
        if fault == "backward":
            return _Refuse.apply(loss)  # type: ignore[no-any-return]
        return loss

    def state(self) -> dict[str, Tensor]:
        return {"calls": self.calls}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        self.calls = state["calls"].clone()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        if len(self.calls):
            self.calls = torch.where(fresh, torch.zeros(()), self.calls[source])


class ToyDropout(r.Modifier[r.Settings]):
    def opacity_scale(self, step: r.Step) -> Tensor:
        return (torch.rand(step.model.count, generator=self.generator) > 0.1).float()


class ToyGrowthSettings(r.Settings):
    prune: bool = True
    empty: bool = False
    wrong: bool = False


class ToyGrowth(r.Densification[ToyGrowthSettings]):
    """Clones, splits and prunes at random."""

    def refine(self, step: r.Step) -> Edit | None:
        count = step.model.count
        if self.settings.empty:
            return None
        if self.settings.wrong:
            return Edit(clone=torch.ones(count + 1, dtype=torch.bool))
        draw = torch.rand(count, generator=self.generator)
        return (
            Edit(clone=draw < 0.1, split=draw > 0.9, prune=(draw > 0.45) & (draw < 0.5))
            if self.settings.prune
            else Edit(clone=draw < 0.5)
        )


class ToyFadeSettings(r.Settings):
    factor: float = 0.9
    value: float | None = None
    reset: bool = False


class ToyFade(r.OpacityPolicy[ToyFadeSettings]):
    def update(self, step: r.Step) -> r.OpacityUpdate | None:
        opacities = step.model.opacities() * self.settings.factor
        if self.settings.value is not None:
            opacities = torch.full_like(opacities, self.settings.value)
        return r.OpacityUpdate(opacities, self.settings.reset)


class ToyPsnr(r.Metric[r.Settings]):
    unit = "dB"

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        error = (rendered - photograph).square()
        if mask is not None:
            error = error[mask]
        return float(-10 * torch.log10(error.mean()))


class ToyExporter(r.Exporter[r.Settings]):
    def export(self, model: GaussianReader, scene: r.Scene, folder: Path) -> list[Path]:
        file = folder / "count.txt"
        file.write_text(str(model.count), "utf-8")
        return [file]


class ToyReport(r.Report[r.Settings]):
    def write(self, folder: Path, scene: r.Scene) -> list[Path]:
        file = folder / "report.txt"
        file.write_text((folder / "results.json").read_text("utf-8")[:20], "utf-8")
        return [file]


class ToyDiarySettings(r.Settings):
    fault: Literal["none", "started", "iterated", "evaluated", "ended", "draws", "writes"] = "none"


class ToyDiary(r.Observer[ToyDiarySettings]):
    """Writes a line for each event; may fail in any."""

    def _note(self, *words: object) -> None:
        if self.folder is not None:
            with (self.folder / "diary.txt").open("a", encoding="utf-8") as file:
                print(*words, file=file)
        if words[0] == self.settings.fault:
            raise ZeroDivisionError(f"boom in {words[0]}")

    def started(self, run: RunStarted) -> None:
        self.folder = run.folder
        self._note("started", run.title, run.iteration, run.resumed, run.iterations)

    def iterated(self, done: IterationDone) -> None:
        self._note("iterated", done.iteration, done.gaussians, *done.numbers)
        if self.settings.fault == "draws":
            torch.rand(())
        if self.settings.fault == "writes":
            for image in (done.target, done.rendering.rgb, done.view.image):
                image.numpy()[:] = 255
            done.view.camera.world_to_camera.zero_()

    def evaluated(self, scored: ViewsScored) -> None:
        self._note("evaluated", scored.iteration, *scored.mean)

    def ended(self, run: RunEnded) -> None:
        self._note("ended", run.iteration, run.finished, run.results is not None, run.error)


@r.hookimpl
def stereogs_register_observers(register: r.Register[ToyDiary]) -> None:
    register("toy_diary", ToyDiary)


@r.hookimpl
def stereogs_register_scenes(register: r.Register[ToyScene]) -> None:
    register("toy_scene", ToyScene)


@r.hookimpl
def stereogs_register_initializers(register: r.Register[ToyPoints]) -> None:
    register("toy_points", ToyPoints)


@r.hookimpl
def stereogs_register_priors(register: r.Register[ToyPrior]) -> None:
    register("toy_prior", ToyPrior)


@r.hookimpl
def stereogs_register_regularizers(register: r.Register[ToyTerm]) -> None:
    register("toy_term", ToyTerm)


@r.hookimpl
def stereogs_register_modifiers(register: r.Register[ToyDropout]) -> None:
    register("toy_dropout", ToyDropout)


@r.hookimpl
def stereogs_register_densifications(register: r.Register[ToyGrowth]) -> None:
    register("toy_growth", ToyGrowth)


@r.hookimpl
def stereogs_register_opacity_policies(register: r.Register[ToyFade]) -> None:
    register("toy_fade", ToyFade)


@r.hookimpl
def stereogs_register_metrics(register: r.Register[ToyPsnr]) -> None:
    register("psnr", ToyPsnr)


@r.hookimpl
def stereogs_register_exporters(register: r.Register[ToyExporter]) -> None:
    register("toy_files", ToyExporter)


@r.hookimpl
def stereogs_register_reports(register: r.Register[ToyReport]) -> None:
    register("toy_report", ToyReport)
