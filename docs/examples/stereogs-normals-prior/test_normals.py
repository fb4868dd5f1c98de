"""Tests by the author of a plugin: the contract, and the purpose of the components."""

from pathlib import Path

import pytest
import torch
from stereogs_normals_prior import RobustNormals, RobustNormalsSettings, ScriptNormals
from torch import Tensor

from core_rasterizer import GaussianModel, Gaussians, Rendering, open_device
from stereogs import api
from stereogs.testing import check, step_of, tiny_scene

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")


class Shading(torch.nn.Module):
    """Surfaces that face away from the light get darker: normals from the gradient of brightness."""

    def forward(self, image: Tensor) -> Tensor:
        grey = torch.nn.functional.pad(image.mean(1, keepdim=True), [1, 1, 1, 1], "replicate")
        x = grey[:, :, 1:-1, 2:] - grey[:, :, 1:-1, :-2]
        y = grey[:, :, 2:, 1:-1] - grey[:, :, :-2, 1:-1]
        return torch.cat([x, y, -torch.ones_like(x)], dim=1)


@pytest.fixture
def prior(tmp_path: Path) -> ScriptNormals:
    torch.jit.script(Shading()).save(tmp_path / "m.pt")
    settings = ScriptNormals.Settings(model=tmp_path / "m.pt")
    return ScriptNormals(settings, api.Context("normals", 0, open_device()))


def test_they_keep_the_contract(prior: ScriptNormals) -> None:
    check(ScriptNormals, model=prior.settings.model)
    check(RobustNormals, priors={"normals": prior})


def test_the_loss_is_larger_on_a_wall_that_the_photograph_does_not_show(
    prior: ScriptNormals,
) -> None:
    scene, one = tiny_scene(), torch.ones(1)
    cloud = Gaussians.from_points(torch.ones(1, 3), torch.ones(1, 3), one, one / 2, 0)
    model, image = GaussianModel(cloud, open_device()), scene.train[0].image
    context = api.Context("robust_normals", 0, open_device())
    losses = []
    for slope in (0.0, 0.1):
        depth = (3 + slope * torch.arange(image.shape[0]))[:, None].expand(image.shape[:2])
        rendering = Rendering(image, depth, torch.ones_like(depth))
        step = step_of(model, scene, rendering=rendering, priors={"normals": prior})
        losses.append(float(RobustNormals(RobustNormalsSettings(), context).loss(step)))
    assert losses[0] < 0.01
    assert losses[1] > 0.3
