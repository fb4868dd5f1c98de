"""Tests by the author of a plugin: the contract, and the kernel against the same formula in torch."""

import pytest
import torch
from stereogs_fused_term import TERM, Charbonnier
from torch import Tensor

from stereogs.api import Rendering
from stereogs.testing import check, check_term


def reference(view: Rendering, target: Tensor, trained: Tensor | None, softness: float) -> Tensor:
    length = ((view.rgb - target).square() + softness**2).sqrt() - softness
    return (length if trained is None else length * trained[:, :, None]).mean()


def test_it_keeps_the_contract() -> None:
    check(Charbonnier)


@pytest.mark.parametrize("masked", [False, True])
def test_the_kernel_computes_the_formula_and_its_gradient(masked: bool) -> None:
    view = Rendering(torch.rand(7, 9, 3), torch.rand(7, 9), torch.rand(7, 9))
    trained = torch.rand(7, 9) > 0.5 if masked else None
    check_term(
        TERM, reference, view=view, target=torch.rand(7, 9, 3), trained=trained, softness=0.1
    )
