"""`check_kernel`: kernels over Gaussians that differ from their reference are found."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import GaussianKernel, GaussianReader
from registry.testing import check_kernel
from tests.core_rasterizer.quick_device import quick_device


def kernel(source: str, **named: Any) -> GaussianKernel:
    return GaussianKernel(
        source, gradients=["opacity_logits"], outputs=["pull"], sums=["total"], **named
    )


def pulls(model: GaussianReader, weights: Tensor) -> tuple[dict[str, Tensor], dict[str, float]]:
    pull = weights * model.gradient("opacity_logits").abs()
    return {"pull": pull}, {"total": float(pull.sum())}


RIGHT = "pull = weights * lane_abs(d_opacity_logits); total = pull;"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        (RIGHT, None),
        (RIGHT.replace("lane_abs", ""), "pull of the kernel.*differs from the reference by up to"),
        (RIGHT.replace("total = pull", "total = 2 * pull"), "total of the kernel.*differs"),
    ],
    ids=["right", "sign", "sum"],
)
def test_a_difference_is_found(source: str, found: str | None) -> None:
    given: dict[str, Any] = {"device": quick_device(), "count": 70, "weights": torch.rand(70)}
    if found is None:
        check_kernel(kernel(source), pulls, **given)
    else:
        with pytest.raises(AssertionError, match=found):
            check_kernel(kernel(source), pulls, **given)


def test_another_name_is_found() -> None:
    other = GaussianKernel("pull = 1;", outputs=["pull"])
    with pytest.raises(
        AssertionError, match=r"\['pull'\], those of the reference \['pull', 'total'\]"
    ):
        check_kernel(other, lambda model: pulls(model, torch.ones(60)), device=quick_device())
