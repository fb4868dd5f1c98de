"""`script_normals` and `robust_normals`: normals from a TorchScript file, and a loss that uses them."""

import io
from pathlib import Path

import torch
from pydantic import Field

from registry.toolkit.images import at_size
from registry.toolkit.networks import read_model_file
from registry.toolkit.views import depth_normals
from stereogs import api


class ScriptNormalsSettings(api.Settings):
    model: Path
    """TorchScript file; `forward` takes `[1, 3, H, W]` in [0, 1] and returns normals of that shape."""


class ScriptNormals(api.NormalPrior[ScriptNormalsSettings]):
    def __init__(self, settings: ScriptNormalsSettings, context: api.Context) -> None:
        super().__init__(settings, context)
        file = read_model_file(settings.model, sha256=None)
        self._module = torch.jit.load(io.BytesIO(file.content), map_location="cpu").eval()

    def estimate(self, image: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(self._module(image.permute(2, 0, 1)[None]))[0].permute(1, 2, 0)


class RobustNormalsSettings(api.Settings):
    prior: str | None = None
    """Name of a prior of normals; null uses the only one."""
    softness: float = Field(0.5, gt=0)
    """Distance of two unit normals, 0 to 2, from which the penalty grows more slowly."""


class RobustNormals(api.Regularizer[RobustNormalsSettings]):
    """Mean of d^2 / (d^2 + softness^2), d the distance between the normals of depth and prior."""

    needs_priors = (api.NormalPrior.capability,)

    def loss(self, step: api.Step) -> torch.Tensor:
        found = depth_normals(step.rendering, step.sample.camera)
        normals = api.NormalPrior.choose(step.priors, self.settings.prior).normals_of(step.view)
        wanted = at_size(normals, *found.shape[:2])
        known = found.any(dim=2) & wanted.any(dim=2)
        if step.view.solid is not None:
            known &= at_size(step.view.solid, *known.shape)
        square = (found - wanted)[known].square().sum(dim=1)
        return (square / (square + self.settings.softness**2)).sum() / known.sum().clamp(min=1)


@api.hookimpl
def stereogs_register_priors(register: api.Register[ScriptNormals]) -> None:
    register("script_normals", ScriptNormals)


@api.hookimpl
def stereogs_register_regularizers(register: api.Register[RobustNormals]) -> None:
    register("robust_normals", RobustNormals)
