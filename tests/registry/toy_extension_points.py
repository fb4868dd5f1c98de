"""Small components that use one extension point of the host each."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

import registry as r
from core_rasterizer import Edit, Gaussians, Relocation
from registry.priors import DepthMap


class TargetSettings(r.Settings):
    brightness: float = 0.5
    background: tuple[float, float, float] = (0.0, 0.0, 1.0)
    first_view: bool = False
    sh_degree: float | None = None
    smoothing: float | None = None
    wrong: bool = False


class ToyTarget(r.Sampler[TargetSettings]):
    """Darkens photographs and changes the background; may always choose the first view."""

    def sample(self, step: r.Step, sample: r.Sample) -> r.Sample:
        settings = self.settings
        view = step.scene.train[0] if settings.first_view else sample.view
        target = settings.brightness * view.image
        degree = sample.sh_degree if settings.sh_degree is None else settings.sh_degree
        smoothing = None
        if settings.smoothing is not None:
            smoothing = torch.full((step.model.count,), settings.smoothing)
        return replace(
            sample,
            view=view,
            camera=view.camera,
            target=target[1:] if settings.wrong else target,
            background=settings.background,
            sh_degree=degree,
            smoothing=smoothing,
        )


class ExposureSettings(r.Settings):
    learning_rate: float = 0.1


class ToyExposure(r.Appearance[ExposureSettings]):
    """Trains one brightness for all photographs; created in `begin_training`."""

    def begin_training(self, scene: r.TrainingScene) -> None:
        self.factor = torch.full((), len(scene.train) / 2.0, requires_grad=True)  # there are two

    def parameters(self) -> Sequence[r.ParameterGroup]:
        return [r.ParameterGroup("factor", [self.factor], self.settings.learning_rate)]

    def colors(self, step: r.Step, rgb: Tensor) -> Tensor:
        step.log("exposure", float(self.factor.detach()))
        return self.factor * rgb


class ToyPose(r.Sampler[r.Settings]):
    """Shifts cameras to the right and trains the shift back to zero."""

    def __init__(self, settings: r.Settings, context: r.Context) -> None:
        super().__init__(settings, context)
        self.offset = torch.tensor([0.05, 0.0, 0.0], dtype=torch.float64, requires_grad=True)

    def parameters(self) -> Sequence[r.ParameterGroup]:
        return [r.ParameterGroup("offset", [self.offset], 2e-3)]

    def sample(self, step: r.Step, sample: r.Sample) -> r.Sample:
        step.log("offset", float(self.offset.detach().norm()))
        target = step.render(sample.camera, gradient=False).rgb.clamp(0, 1)
        pose = sample.camera.world_to_camera.clone()
        pose[:3, 3] += self.offset
        camera = replace(sample.camera, world_to_camera=pose)
        return replace(sample, camera=camera, target=target)


class NoiseSettings(r.Settings):
    wrong: bool = False


class ToyNoise(r.Perturbation[NoiseSettings]):
    """Moves means by noise as large as Adam's step."""

    def offsets(self, step: r.Step) -> Mapping[str, Tensor]:
        rows = {len(mask) for mask in step.kinds.values()}
        assert rows <= {step.model.count}
        if step.kinds:
            step.log("even", int(step.kinds["even"].sum()))
        count = step.model.count + self.settings.wrong
        noise = torch.randn(count, 3, generator=self.generator)
        return {"means": step.learning_rates["means"] * noise}


class ShapeSettings(r.Settings):
    moves: tuple[str, ...] | None = None
    parameter: Literal["scales", "opacities"] = "scales"


class ToyShape(r.Regularizer[ShapeSettings]):
    """A loss on parameters alone."""

    @property
    def moves(self) -> Collection[str] | None:
        return self.settings.moves

    def loss(self, step: r.Step) -> Tensor:
        return step.parameter(self.settings.parameter).square().mean()


class PictureSettings(r.Settings):
    moves: tuple[str, ...] | None = None
    detach: tuple[str, ...] = ()
    opacity: float | None = None


class ToyPicture(r.Regularizer[PictureSettings]):
    """A loss on the alpha of the current view, at one opacity and with detached parameters."""

    @property
    def moves(self) -> Collection[str] | None:
        return self.settings.moves

    def loss(self, step: r.Step) -> Tensor:
        scale = None
        if self.settings.opacity is not None:
            scale = self.settings.opacity / step.model.opacities()
        rendering = step.render(
            step.view.camera,
            background=(1.0, 1.0, 1.0),
            opacity_scale=scale,
            detach=self.settings.detach,
            sh_degree=0,
        )
        step.log("seen", float(rendering.visible.sum()))
        return rendering.rgb.mean() - rendering.alpha.mean()


class ToyTwin(r.Regularizer[r.Settings]):
    """A loss on the difference to the renders of other fields."""

    @classmethod
    def needs_rendered(cls, settings: r.Settings) -> tuple[r.Rendered, ...]:
        return ("other_fields",)

    def loss(self, step: r.Step) -> Tensor:
        step.log("others", len(step.others))
        terms = [(step.rendering.rgb - o.rendering.rgb).abs().mean() for o in step.others]
        for other in step.others:
            assert not other.render(step.view.camera).rgb.requires_grad
            assert not other.rendering.rgb.requires_grad
        return torch.stack(terms).sum() if terms else step.rendering.rgb.sum() * 0


class ToyGuide(r.Regularizer[r.Settings]):
    """A loss on the initializer's depth."""

    def loss(self, step: r.Step) -> Tensor:
        known = step.maps[step.view.name]
        wrong = (step.rendering.depth - known.depth)[known.valid]
        return wrong.abs().mean()


class PeekSettings(r.Settings):
    at: Literal["test", "depth", "early"] = "test"


class ToyPeek(r.Modifier[PeekSettings]):
    """Reads data that is not available during training."""

    def opacity_scale(self, step: r.Step) -> Tensor:
        if self.settings.at == "test":
            return torch.ones(len(step.scene.test))
        if self.settings.at == "depth":
            depth = step.view.depth
            assert depth is not None
            return depth
        return step.rendering.alpha


class GuidedSettings(r.Settings):
    peek: bool = False


class ToyGuided(r.Initializer[GuidedSettings]):
    """The scene's points, with kinds for even and odd indices, and depth 3 for each view."""

    def initialize(self, scene: r.TrainingScene, priors: Mapping[str, Any]) -> r.PointCloud:
        assert scene.points is not None
        views = scene.test if self.settings.peek else scene.train
        maps = {}
        for view in views:
            depth = torch.full(view.image.shape[:2], 3.0)
            valid = torch.ones_like(depth, dtype=torch.bool)
            maps[view.name] = DepthMap(depth, valid, valid.float())
        odd = torch.arange(len(scene.points)) % 2 == 1
        return replace(scene.points, maps=maps, kinds={"even": ~odd, "odd": odd})


class MoveSettings(r.Settings):
    children: int = 2
    shrink: float = 1.6
    add: int = 0
    relocate: int = 0
    absolute: bool = False


class ToyMove(r.Densification[MoveSettings]):
    """Splits the first Gaussian, adds and moves some, as set; counts its calls."""

    def __init__(self, settings: MoveSettings, context: r.Context) -> None:
        super().__init__(settings, context)
        self.parent = torch.zeros(0, dtype=torch.int64)

    @classmethod
    def needs_rendered(cls, settings: MoveSettings) -> tuple[r.Rendered, ...]:
        return ("screen_gradient", *(("absolute_screen_gradient",) if settings.absolute else ()))

    def refine(self, step: r.Step) -> Edit:
        count, settings = step.model.count, self.settings
        if settings.absolute:
            absolute = step.model.absolute_screen_gradient()
            assert (absolute >= step.model.screen_gradient() * (1 - 1e-5)).all()
            step.log("absolute", float(absolute.sum()))
        split = torch.zeros(count, dtype=torch.bool)
        split[0] = settings.children > 2
        added = None
        if settings.add:
            known = step.model.gaussians()
            added = Gaussians(**{name: rows[: settings.add] for name, rows in vars(known).items()})
        self.parent = torch.arange(count)
        return Edit(
            split=split,
            split_into=settings.children,
            shrink=settings.shrink,
            add=added,
            parents=None if added is None else torch.arange(1, settings.add + 1),
            relocate=Relocation(
                torch.full((settings.relocate,), 1), torch.arange(2, 2 + settings.relocate)
            )
            if settings.relocate
            else None,
        )

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        if len(self.parent):
            self.parent = self.parent[source]


@r.hookimpl
def stereogs_register_initializers(register: r.Register[ToyGuided]) -> None:
    register("toy_guided", ToyGuided)


@r.hookimpl
def stereogs_register_samplers(register: r.Register[Any]) -> None:
    register("toy_target", ToyTarget)
    register("toy_pose", ToyPose)


@r.hookimpl
def stereogs_register_appearances(register: r.Register[ToyExposure]) -> None:
    register("toy_exposure", ToyExposure)


@r.hookimpl
def stereogs_register_perturbations(register: r.Register[ToyNoise]) -> None:
    register("toy_noise", ToyNoise)


@r.hookimpl
def stereogs_register_modifiers(register: r.Register[ToyPeek]) -> None:
    register("toy_peek", ToyPeek)


@r.hookimpl
def stereogs_register_densifications(register: r.Register[ToyMove]) -> None:
    register("toy_move", ToyMove)


@r.hookimpl
def stereogs_register_regularizers(register: r.Register[Any]) -> None:
    for name, component in (
        ("toy_shape", ToyShape),
        ("toy_picture", ToyPicture),
        ("toy_twin", ToyTwin),
        ("toy_guide", ToyGuide),
    ):
        register(name, component)
