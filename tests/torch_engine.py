"""A second engine in plain torch on `core_rasterizer.reference`: slow, and only for tests of the protocol.

Tests of `core_rasterizer`, which import its modules.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from core_rasterizer import (
    Camera,
    Carried,
    Device,
    Edit,
    GaussianError,
    Gaussians,
    Rendering,
    reference,
)
from core_rasterizer.layout import MAX_LOGIT, PARAMETER_GROUPS, PARAMETERS
from core_rasterizer.raster import Footprint

NO_BACKGROUND = (0.0, 0.0, 0.0)
_BETAS, _EPSILON = (0.9, 0.999), 1e-15


@dataclass
class Seen:
    """Which Gaussians of a render have an ellipse in the image."""

    mask: Tensor

    def visible(self) -> Tensor:
        return self.mask


class TorchStatistics:
    """Sums of the norms of screen-space gradients, and how often each Gaussian was seen."""

    def __init__(self, count: int) -> None:
        self._sums = torch.zeros(2, count)

    def add(self, indices: Tensor, norms: Tensor) -> None:
        self._sums[0].index_add_(0, indices, norms.float())
        self._sums[1].index_add_(0, indices, (norms > 0).float())

    def screen_gradient(self) -> Tensor:
        return self._sums[0] / self._sums[1].clamp(min=1)

    def absolute_screen_gradient(self) -> Tensor:
        raise GaussianError("this engine collects no absolute screen gradients", field="means")

    def reset(self) -> None:
        self._sums.zero_()

    def sums(self) -> Tensor:
        return self._sums.clone()

    def restore(self, sums: Tensor) -> None:
        self._sums = sums.clone()


class TorchModel:
    """Parameters as leaves of autograd."""

    def __init__(self, engine: TorchEngine, gaussians: Gaussians, footprint: Footprint) -> None:
        gaussians.check_finite()
        self.engine, self.footprint = engine, footprint
        self.anchor = torch.zeros((), requires_grad=True)
        self.backward_passes = 0
        self.adopt({name: getattr(gaussians, name) for name in PARAMETERS})

    def adopt(self, values: Mapping[str, Tensor]) -> None:
        self.leaves = {name: values[name].detach().float().clone() for name in PARAMETERS}
        for leaf in self.leaves.values():
            leaf.requires_grad_()
        self.statistics = TorchStatistics(self.count)
        self.zero_gradients()

    @property
    def count(self) -> int:
        return len(self.leaves["means"])

    @property
    def sh_degree(self) -> int:
        return math.isqrt(self.leaves["sh"].shape[1]) - 1

    def read(self, name: str) -> Tensor:
        return self.leaves[name].detach()

    def write(self, name: str, values: Tensor) -> None:
        if not torch.isfinite(values).all():
            raise GaussianError("a value is not finite", field=name)
        with torch.no_grad():
            self.leaves[name].copy_(values)

    def gradient(self, name: str) -> Tensor:
        leaf = self.leaves[name]
        return torch.zeros_like(leaf) if leaf.grad is None else leaf.grad

    def gradient_of_renders(self, group: str) -> Tensor:
        return _rows(self, {name: self.gradient(name) for name in PARAMETERS}, group)

    def zero_gradients(self) -> None:
        for leaf in self.leaves.values():
            leaf.grad = None

    def parameter(self, name: str) -> Tensor:
        values = {"opacities": self._opacities, "scales": lambda: self.leaves["log_scales"].exp()}
        found = values[name]() if name in values else self.leaves[name]
        return self._counted(found + self.anchor)

    def _opacities(self) -> Tensor:
        return self.leaves["opacity_logits"].sigmoid()

    def _counted(self, values: Tensor) -> Tensor:
        def count(gradient: Tensor) -> None:
            self.backward_passes += 1

        if values.requires_grad:
            values.register_hook(count)
        return values

    def opacities(self) -> Tensor:
        return self._opacities().detach()

    def scales(self) -> Tensor:
        return self.read("log_scales").exp()

    def touched(self) -> Tensor:
        names = ("means", "opacity_logits", "sh")
        return torch.stack([_any(self.gradient(name) != 0) for name in names]).any(dim=0)

    def gaussians(self) -> Gaussians:
        return Gaussians(**{name: self.read(name).clone() for name in PARAMETERS})

    def digest(self) -> str:
        values = [self.read(name).contiguous().numpy().tobytes() for name in PARAMETERS]
        return hashlib.sha256(b"".join(values)).hexdigest()

    def render(
        self,
        camera: Camera,
        *,
        background: Sequence[float] = NO_BACKGROUND,
        sh_degree: float | None = None,
        opacity_scale: Tensor | None = None,
        smoothing: Tensor | None = None,
        collect_statistics: bool = False,
        collect_absolute: bool = False,
        detach: Collection[str] = (),
    ) -> Rendering:
        values = {
            name: leaf.detach() if name in detach else leaf + self.anchor
            for name, leaf in self.leaves.items()
        }
        opacities = values["opacity_logits"].sigmoid()
        projected = reference.project(
            values["means"],
            values["quaternions"],
            values["log_scales"].exp(),
            opacities if opacity_scale is None else opacities * opacity_scale,
            values["sh"],
            camera,
            dilation=self.footprint.dilation,
            compensate_dilation=self.footprint.compensated,
            smoothing=smoothing,
            sh_degree=sh_degree,
        )
        if collect_statistics and projected.centers.requires_grad:
            half = torch.tensor([camera.width / 2, camera.height / 2], dtype=torch.float64)
            indices, statistics = projected.indices, self.statistics
            projected.centers.register_hook(
                lambda gradient: statistics.add(indices, (gradient * half).norm(dim=1))
            )
        image = reference.composite(projected, camera.width, camera.height, background)
        rgb = self._counted(image.rgb.float())
        mask = torch.zeros(self.count, dtype=torch.bool)
        mask[projected.indices] = True
        return Rendering(rgb, image.depth.float(), image.alpha.float(), Seen(mask))


class TorchAdam:
    """Adam with one learning rate and step count per group."""

    def __init__(self, model: TorchModel) -> None:
        self._model = model
        self.moments = [_zeros(model) for _ in _BETAS]
        self._steps = dict.fromkeys(PARAMETER_GROUPS, 0)

    def step(
        self,
        learning_rates: Mapping[str, float],
        active_sh_degree: float,
        *,
        skip: Collection[str] = (),
        keep_gradients: bool = True,
    ) -> None:
        model = self._model
        for group, rate in learning_rates.items():
            if group in skip or ("sh" in skip and group.startswith("sh_")):
                continue
            self._steps[group] += 1
            name, part = _place(group)
            with torch.no_grad():
                gradient = model.gradient(name)[part]
                powers = (gradient, gradient * gradient)
                corrected = []
                for moments, beta, power in zip(self.moments, _BETAS, powers, strict=True):
                    moments[name][part] = beta * moments[name][part] + (1 - beta) * power
                    corrected.append(moments[name][part] / (1 - beta ** self._steps[group]))
                first, second = corrected
                model.leaves[name][part] -= rate * first / (second.sqrt() + _EPSILON)
                if name == "opacity_logits":
                    model.leaves[name].clamp_(-MAX_LOGIT, MAX_LOGIT)

    def check_parameters(self) -> None:
        self._model.gaussians().check_finite()

    def reset_moments(self, name: str) -> None:
        parameter, part = _place(name)
        for moments in self.moments:
            moments[parameter][part] = 0

    def state(self) -> dict[str, Tensor]:
        named = zip(("first", "second"), self.moments, strict=True)
        state = {f"{which}_{name}": v.clone() for which, m in named for name, v in m.items()}
        return {**state, "steps": torch.tensor(list(self._steps.values()))}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        for which, moments in zip(("first", "second"), self.moments, strict=True):
            for name in PARAMETERS:
                moments[name] = state[f"{which}_{name}"].clone()
        self._steps = dict(zip(PARAMETER_GROUPS, state["steps"].tolist(), strict=True))


@dataclass(frozen=True)
class TorchEngine:
    """Implements `core_rasterizer.Engine`."""

    device: Device
    name: str = "torch"
    absolute_gradients: bool = False

    def model(
        self, gaussians: Gaussians, *, dilation: float, compensate_dilation: bool
    ) -> TorchModel:
        return TorchModel(self, gaussians, Footprint(dilation, compensate_dilation))

    def optimizer(self, model: TorchModel) -> TorchAdam:
        return TorchAdam(model)

    def loss(
        self, image: Tensor | Rendering, target: Tensor, ssim_weight: float, l1_weight: float | None
    ) -> Tensor:
        from tests.core_rasterizer.test_photometric import twin

        rgb = image.rgb if isinstance(image, Rendering) else image
        return twin(rgb, target, ssim_weight, l1_weight).float()

    def edit(
        self, model: TorchModel, optimizer: TorchAdam, edit: Edit, generator: torch.Generator
    ) -> Carried:
        count = model.count
        edit.check(count)
        if edit.relocate is not None or edit.add is not None:
            raise GaussianError("this engine only clones, splits and prunes", field="edit")
        masks = {name: edit.mask(name, count) for name in ("clone", "split", "prune")}
        kept, cloned, split = (
            mask.nonzero()[:, 0]
            for mask in (~(masks["prune"] | masks["split"]), masks["clone"], masks["split"])
        )
        children = split.repeat(edit.split_into)
        source = torch.cat([kept, cloned, children])
        values = {name: model.read(name)[source].clone() for name in PARAMETERS}
        if len(children):
            noise = torch.randn(len(children), 3, generator=generator, dtype=torch.float64).float()
            turned = reference.rotation_matrices(model.read("quaternions")[children])
            spread = turned @ (model.scales()[children] * noise)[:, :, None]
            values["means"][-len(children) :] += spread[:, :, 0]
            values["log_scales"][-len(children) :] -= math.log(edit.shrink)
        fresh = torch.arange(len(source)) >= len(kept)
        for moments in optimizer.moments:
            for name in PARAMETERS:
                moments[name] = moments[name][source]
                moments[name][fresh] = 0
        model.adopt(values)
        return Carried(source, fresh)


def _zeros(model: TorchModel) -> dict[str, Tensor]:
    return {name: torch.zeros_like(model.read(name)) for name in PARAMETERS}


def _place(group: str) -> tuple[str, tuple[slice, ...]]:
    """The parameter that a group is part of, and which part."""
    if group == "sh_constant":
        return "sh", (slice(None), slice(0, 1))
    if group == "sh_rest":
        return "sh", (slice(None), slice(1, None))
    return group, (slice(None),)


def _rows(model: TorchModel, values: Mapping[str, Tensor], group: str) -> Tensor:
    name, part = _place(group)
    return values[name][part].reshape(model.count, -1).T


def _any(mask: Tensor) -> Tensor:
    return mask.reshape(len(mask), -1).any(dim=1)
