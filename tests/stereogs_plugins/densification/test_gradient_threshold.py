from __future__ import annotations

from dataclasses import replace

import torch

from core_rasterizer import Edit
from registry import Step
from registry.testing import check
from stereogs_plugins.densification.gradient_threshold import (
    GradientThreshold,
    stereogs_register_densifications,
)
from tests.core_rasterizer.quick_device import quick_device
from tests.stereogs_plugins.building import (
    build,
    moment_with,
    offered,
    some_gaussians,
    step_with,
)

SCALES = [0.02, 0.02, 0.3, 0.3, 0.05, 0.08]
OPACITIES = [0.5, 0.001, 0.5, 0.001, 0.9, 0.9]


def some_step(iteration: int = 500) -> Step:
    return step_with(some_gaussians(SCALES, OPACITIES), iteration=iteration)


def edit_of(policy: GradientThreshold, step: Step) -> Edit:
    edit = policy.refine(step)
    assert edit is not None
    return edit


def between(values: torch.Tensor) -> float:
    """A threshold that about half of the values reach."""
    ordered = values.sort().values
    middle = len(ordered) // 2
    return float((ordered[middle - 1] + ordered[middle]) / 2)


def test_is_offered_as_gradient_threshold() -> None:
    assert offered(stereogs_register_densifications) == {"gradient_threshold": GradientThreshold}


def test_small_ones_are_cloned_and_large_ones_split_where_the_gradient_is_high() -> None:
    step = some_step()
    gradient = step.model.screen_gradient()
    threshold = between(gradient)
    settings = {"gradient_threshold": threshold, "percent_dense": 0.06, "min_opacity": 0.0}
    edit = edit_of(build(GradientThreshold, **settings), step)
    assert edit.clone is not None
    assert edit.split is not None
    pulled = (gradient >= threshold).tolist()
    assert 0 < sum(pulled) < len(pulled)
    small = [scale <= 0.06 for scale in SCALES]
    assert edit.clone.tolist() == [p and s for p, s in zip(pulled, small, strict=True)]
    assert edit.split.tolist() == [p and not s for p, s in zip(pulled, small, strict=True)]


def test_splits_may_go_by_gradients_that_do_not_cancel() -> None:
    """AbsGS: stripes pull a wide Gaussian to both sides at once."""
    gaussians = some_gaussians([0.02, 0.02, 0.3], [0.5, 0.5, 0.5])
    step, _ = moment_with(gaussians, absolute=True)
    signed, absolute = step.model.screen_gradient(), step.model.absolute_screen_gradient()
    assert float(absolute[2]) > 2 * float(signed[2])
    threshold = float(absolute[2]) * 0.9
    usual = edit_of(build(GradientThreshold, gradient_threshold=threshold), step)
    numbers = {"gradient_threshold": 1e-12, "percent_dense": 0.1}
    policy = build(GradientThreshold, absolute_threshold=threshold, **numbers)
    edit = edit_of(policy, step)
    assert "absolute_screen_gradient" in policy.needs_rendered(policy.settings)
    assert usual.split is not None
    assert edit.split is not None
    assert edit.clone is not None
    assert usual.split.tolist() == [False, False, False]
    assert edit.split.tolist() == [False, False, True]
    assert edit.clone.tolist() == [True, True, False]
    check(GradientThreshold, absolute_threshold=4e-4, device=quick_device())


def test_the_limits_scale_with_the_extent() -> None:
    step = some_step()
    step = replace(step, extent=100.0)
    edit = edit_of(build(GradientThreshold, gradient_threshold=1e-12), step)
    assert edit.split is not None
    assert not edit.split.any()


def test_faint_ones_are_pruned() -> None:
    edit = edit_of(build(GradientThreshold), some_step())
    assert edit.prune is not None
    assert edit.prune.tolist() == [False, True, False, True, False, False]


def test_oversized_ones_are_pruned_only_after_the_given_iteration() -> None:
    settings: dict[str, object] = {"min_opacity": 0.0, "gradient_threshold": 1e9}
    for iteration, start, pruned in (
        (3000, 3000, False),
        (3001, 3000, True),
        (9000, None, False),
    ):
        policy = build(GradientThreshold, size_prune_from=start, **settings)
        edit = edit_of(policy, some_step(iteration))
        assert edit.prune is not None
        assert edit.prune.tolist() == [pruned and scale > 0.1 for scale in SCALES]


def test_an_oversized_one_is_split_if_its_children_are_small_enough() -> None:
    step = step_with(some_gaussians([0.15, 0.18], [0.9, 0.9]), iteration=5000)
    edit = edit_of(build(GradientThreshold, gradient_threshold=1e-12), step)
    assert edit.split is not None
    assert edit.prune is not None
    assert edit.split.tolist() == [True, True]
    assert edit.prune.tolist() == [False, True]  # 0.15 / 1.6 < 0.1 < 0.18 / 1.6


def test_never_removes_everything() -> None:
    settings: dict[str, object] = {"gradient_threshold": 1e9}
    step = step_with(some_gaussians([0.02, 0.02], [0.001, 0.001]))
    assert edit_of(build(GradientThreshold, **settings), step).prune is None
    one_left = step_with(some_gaussians([0.02, 0.02], [0.001, 0.9]))
    assert edit_of(build(GradientThreshold, **settings), one_left).prune is not None
    assert edit_of(build(GradientThreshold, min_gaussians=2, **settings), one_left).prune is None


def test_children_shrink_by_four_fifths_of_their_number() -> None:
    usual, four = (
        edit_of(build(GradientThreshold, **s), some_step()) for s in ({}, {"split_into": 4})
    )
    assert (usual.split_into, usual.shrink) == (2, 1.6)
    assert (four.split_into, four.shrink) == (4, 0.8 * 4)  # NexusGS divides by 0.8 * 4
    step = some_step(iteration=4000)
    wide = {"gradient_threshold": 1e-9, "percent_dense": 0.06, "max_size": 0.1, "min_opacity": 0.0}
    for children, gone in ((2, True), (4, False)):  # 0.3 / 1.6 is above 0.1, 0.3 / 3.2 below
        edit = edit_of(build(GradientThreshold, split_into=children, **wide), step)
        assert edit.prune is not None
        assert bool(edit.prune[2]) == gone


def test_nothing_is_done_where_there_are_enough_for_the_pixels() -> None:
    step = some_step()  # 6 Gaussians, one photograph of 64 x 48
    for most, done in ((6 / (64 * 48), False), (7 / (64 * 48), True), (None, True)):
        edit = build(GradientThreshold, most_per_pixel=most).refine(step)
        assert (edit is not None) == done
    check(GradientThreshold, most_per_pixel=1.0)
