from __future__ import annotations

from dataclasses import replace
from typing import Literal

import pytest
import torch
from torch import Tensor

from registry import PluginError
from registry.testing import check
from stereogs_plugins.regularizers.known_depth import PatchDepth
from stereogs_plugins.regularizers.known_depth.patch_depth import Patches
from tests.stereogs_plugins.building import build, moment_with, some_gaussians
from tests.stereogs_plugins.regularizers.known_depth.steps import fixed
from tests.stereogs_plugins.regularizers.monocular import Brightness

KNOWN = torch.ones(4, 4, dtype=torch.bool)
RAMP = torch.arange(16.0, dtype=torch.float64).reshape(4, 4)


def normalized(image: Tensor, side: int, form: str) -> Tensor:
    """DNGaussian's normalization of each patch, written with plain loops."""
    rows = []
    for top in range(0, image.shape[0] - side + 1, side):
        for left in range(0, image.shape[1] - side + 1, side):
            patch = image[top : top + side, left : left + side].flatten()
            spread = image.std() if form == "global" else patch.std() + 0.01 * image.std()
            rows.append((patch - patch.mean()) / spread)
    return torch.stack(rows)


def test_it_keeps_the_contract() -> None:
    for form in ("hard", "soft"):
        check(PatchDepth, form=form, priors={"mono": build(Brightness)})


def test_a_small_array_by_hand() -> None:
    """The patch 0 1 / 4 5 of the numbers 0 to 15: mean 2.5, deviations 2.380 and 4.761."""
    first = torch.tensor([-2.5, -1.5, 1.5, 2.5], dtype=torch.float64)
    patches = Patches(RAMP, KNOWN, 2)
    torch.testing.assert_close(patches.normalized("global")[0], first / 4.760952, rtol=1e-5, atol=0)
    torch.testing.assert_close(
        patches.normalized("local")[0], first / (2.380476 + 0.04760952), rtol=1e-5, atol=0
    )


@pytest.mark.parametrize("form", ["local", "global"])
@pytest.mark.parametrize("side", [2, 3, 5])
def test_patches_are_normalized_as_written(form: Literal["local", "global"], side: int) -> None:
    image = torch.rand(13, 17, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = Patches(image, torch.ones_like(image, dtype=torch.bool), side)
    wanted = normalized(image, side, form)
    torch.testing.assert_close(found.normalized(form), wanted)


def test_small_arrays_differ_by_what_the_authors_code_answers() -> None:
    """1.27997 and 0.84404 came from utils/loss_utils.py of the authors' repository, with sides of 2.

    Its global form divides by 1.01 of the spread; the paper and this one by the spread.
    """
    rendered = torch.arange(24.0, dtype=torch.float64).reshape(4, 6) ** 2
    wanted = torch.arange(24.0, dtype=torch.float64).reshape(4, 6) * 3 % 7
    known = torch.ones(4, 6, dtype=torch.bool)
    ours, target = Patches(rendered, known, 2), Patches(wanted, known, 2)
    local = (ours.normalized("local") - target.normalized("local")).square()
    shared = (ours.normalized("global") - target.normalized("global")).square()
    assert float(local.mean()) == pytest.approx(1.2799738, rel=1e-6)
    assert float(shared.mean()) / 1.01**2 == pytest.approx(0.8440429, rel=1e-6)


def test_unknown_pixels_take_no_part() -> None:
    image, known = RAMP.clone(), KNOWN.clone()
    known[0, 0] = False
    image[0, 0] = 1e6
    found = Patches(image, known, 2).normalized("local")[0]
    three = torch.tensor([1.0, 4.0, 5.0], dtype=torch.float64)
    spread = three.std() + 0.01 * RAMP[known].std()
    torch.testing.assert_close(found[1:], (three - three.mean()) / spread)
    assert found[0] == 0


def test_the_local_gradient_is_that_of_finite_differences() -> None:
    image = torch.rand(6, 6, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    known = torch.ones_like(image, dtype=torch.bool)

    def ours(x: Tensor) -> Tensor:
        return Patches(x, known, 3).normalized("local")

    assert torch.autograd.gradcheck(ours, (image.requires_grad_(),))


def test_the_global_spread_is_a_constant_to_the_gradient() -> None:
    image = torch.rand(6, 6, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    known = torch.ones_like(image, dtype=torch.bool)
    spread = image.std()
    answer = Patches(image.requires_grad_(), known, 3).normalized("global")
    (gradient,) = torch.autograd.grad(answer[0, 0], image)
    assert float(gradient[0, 0]) == pytest.approx((1 - 1 / 9) / float(spread))


def test_hard_moves_centres_and_soft_moves_opacities_only() -> None:
    ramp = torch.linspace(0, 1, 64)[None, :].expand(48, 64).contiguous()
    for form, moved in (("hard", "means"), ("soft", "opacity_logits")):
        step, model = moment_with(some_gaussians([0.4, 0.5, 0.6], [0.3, 0.8, 0.6]))
        step = replace(step, priors={"mono": fixed(ramp)})
        model.zero_gradients()
        term = build(PatchDepth, form=form, smallest=12, largest=12)
        term.loss(step).backward()
        assert list(term.moves) == [moved]
        for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
            assert bool(model.gradient(name).any()) == (name == moved), (form, name)


def test_a_target_that_is_a_scaled_and_shifted_depth_costs_nothing() -> None:
    step, _ = moment_with(some_gaussians([0.4, 0.5, 0.6], [0.3, 0.8, 0.6]))
    depth = step.render(step.view.camera, gradient=False).depth
    # Inverse depth: the larger, the nearer.
    step = replace(step, priors={"mono": fixed(40 - 3 * depth)})
    sides = {"smallest": 16, "largest": 16}
    assert float(build(PatchDepth, form="soft", **sides).loss(step)) == 0
    step = replace(step, priors={"mono": fixed(3 * depth)})
    assert float(build(PatchDepth, form="soft", **sides).loss(step).detach()) > 0.1


def test_sizes_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(PluginError, match="smallest patch, 9"):
        build(PatchDepth, form="hard", smallest=9, largest=5)
