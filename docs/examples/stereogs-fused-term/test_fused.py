"""Tests by the author of a plugin: the contract, and each kernel against the same formula in torch."""

import pytest
import torch
from stereogs_fused_term import FADE, TERM, Charbonnier, UnusedFade
from torch import Tensor

from stereogs.api import GaussianReader, Rendering
from stereogs.testing import check, check_kernel, check_term


def reference(view: Rendering, target: Tensor, trained: Tensor | None, softness: float) -> Tensor:
    length = ((view.rgb - target).square() + softness**2).sqrt() - softness
    return (length if trained is None else length * trained[:, :, None]).mean()


def faded(
    model: GaussianReader, rate: float, softness: float
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    lost = rate * torch.exp(-model.gradient("opacity_logits").abs() / softness)
    return {"faded": model.opacities() * (1 - lost)}, {"fading": lost.sum()}


@pytest.mark.parametrize("component", [Charbonnier, UnusedFade])
def test_they_keep_the_contract(component: type[Charbonnier] | type[UnusedFade]) -> None:
    check(component)


@pytest.mark.parametrize("masked", [False, True])
def test_the_kernel_computes_the_formula_and_its_gradient(masked: bool) -> None:
    view = Rendering(torch.rand(7, 9, 3), torch.rand(7, 9), torch.rand(7, 9))
    trained = torch.rand(7, 9) > 0.5 if masked else None
    check_term(
        TERM, reference, view=view, target=torch.rand(7, 9, 3), trained=trained, softness=0.1
    )


@pytest.mark.parametrize("softness", [1e-3, 10])
def test_the_policy_computes_the_formula(softness: float) -> None:
    check_kernel(FADE, faded, rate=0.5, softness=softness)
