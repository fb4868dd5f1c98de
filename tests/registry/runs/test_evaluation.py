"""Scores of views: missing scores, means, and the average error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from torch import Tensor

import registry as r
from core_rasterizer import Device, GaussianModel, Rendering
from registry import Context
from registry.runs.evaluation import Scores, average_error, averaged, evaluate
from registry.testing import tiny_scene
from tests.host import (
    HOOK_POINTS,
    HostSettings,
    Item,
    Offer,
    Part,
    Place,
    TrainingSettings,
    initial_gaussians,
)

PLACE = Place("a.yaml", 3)
METRICS = next(point for point in HOOK_POINTS if point.section == "metrics")


class Fixed(r.Metric[r.Settings]):
    """Returns the answer of the class, for any images."""

    answer: Any = 0.0

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        answer: float = self.answer
        return answer


class OfView(r.ViewMetric[r.Settings]):
    """Returns a score that needs the view and the scene."""

    def measure_view(
        self, rendering: Rendering, view: r.View, scene: r.Scene
    ) -> float | r.Unavailable:
        if view.depth is None:
            return r.Unavailable(f"no depth in {scene.name}")
        return float(rendering.depth.shape[1])


def part(use: str, component: type[r.ViewMetric[Any]], device: Device, name: str = "") -> Part:
    offer = Offer(METRICS, use, component, "tests", "tests", "1")
    item = Item(name or use, r.Settings(), HostSettings(use=use), offer, PLACE)
    return Part(item, component(r.Settings(), Context(use, 0, device)))


ROLES = {
    "psnr": "peak_signal_to_noise_ratio",
    "ssim": "structural_similarity",
    "ssim_skimage": "structural_similarity",
    "lpips": "perceptual_distance",
}


def answering(use: str, answer: Any, device: Device, name: str = "") -> Part:
    return part(use, in_role(use, answer), device, name)


def in_role(use: str, answer: Any = 0.0) -> type[Fixed]:
    """Return a metric with the role in the average error that its name implies."""
    content = {"answer": answer, "average_error_role": ROLES.get(use)}
    return type("Answering", (Fixed,), content)


def scored(device: Device, *parts: Part, scene: r.Scene | None = None) -> Scores:
    scene = scene or tiny_scene()
    assert scene.points is not None
    model = GaussianModel(initial_gaussians(scene.points, TrainingSettings(sh_degree=0)), device)
    return evaluate(model, scene, scene.train, parts)


class Scaling(r.ViewMetric[r.Settings]):
    """Scales all that it receives through numpy, as ordinary code for 8-bit images does."""

    def measure_view(self, rendering: Rendering, view: r.View, scene: r.Scene) -> float:
        for image in (rendering.rgb, view.image, scene.train[0].image, scene.test[0].image):
            image.numpy()[:] *= 255
        return float(rendering.rgb.max())


class Difference(r.Metric[r.Settings]):
    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        return float((rendered - photograph).abs().mean())


def test_no_metric_can_change_the_score_of_another(device: Device) -> None:
    good = part("difference", Difference, device)
    alone = scored(device, good).mean["difference"]
    mean = scored(device, part("scaling", Scaling, device), good).mean
    assert mean["difference"] == alone
    assert mean["scaling"] is not None
    assert 1 < mean["scaling"] <= 255


def test_an_unavailable_metric_has_no_score_but_a_reason(device: Device) -> None:
    scores = scored(device, answering("lost", r.Unavailable("no file"), device))
    assert scores.views == {"view0": {"lost": None}, "view2": {"lost": None}}
    assert scores.unavailable == {"lost": "no file"}
    assert scores.mean == {"lost": None}


def test_the_mean_is_over_the_views_that_have_the_score(device: Device) -> None:
    scene = tiny_scene()
    blind = replace(scene, train=(replace(scene.train[0], depth=None), scene.train[1]))
    scores = scored(device, part("of_view", OfView, device), scene=blind)
    assert scores.views["view0"] == {"of_view": None}
    assert scores.mean == {"of_view": 32}
    assert scores.unavailable == {"of_view": "no depth in tiny"}


@pytest.mark.parametrize(
    ("answer", "why"),
    [(math.nan, "not a number"), ("high", "is a str, expected"), (None, "is a NoneType, expected")],
)
def test_an_invalid_score_is_missing_and_names_the_metric(
    device: Device, answer: Any, why: str
) -> None:
    scores = scored(device, answering("bad", answer, device), answering("good", 1.0, device))
    assert scores.views == {view: {"bad": None, "good": 1.0} for view in ("view0", "view2")}
    assert why in scores.unavailable["bad"]
    assert list(scores.failures) == ["metrics.bad"]
    assert "metric 'bad'" in scores.failures["metrics.bad"].where
    assert "a.yaml:3" in scores.failures["metrics.bad"].where


def test_an_infinite_score_is_kept_and_its_views_are_listed(device: Device) -> None:
    scores = scored(device, answering("psnr", math.inf, device))
    assert scores.mean == {"psnr": math.inf}
    assert scores.infinite == {"psnr": ["view0", "view2"]}
    assert (scores.failures, scores.unavailable) == ({}, {})


def test_the_average_error_is_the_geometric_mean_of_three() -> None:
    assert average_error(20, 0.75, 0.2) == pytest.approx((0.01 * 0.5 * 0.2) ** (1 / 3))
    assert average_error(100, 1 + 1e-12, 0.0) == 0


@pytest.mark.parametrize("ssim", ["ssim", "ssim_skimage"])
def test_views_with_all_three_get_an_average_error(device: Device, ssim: str) -> None:
    names = (("lpips", 0.2), (ssim, 0.75), ("psnr", 20.0))
    parts = [answering(use, value, device, f"my_{use}") for use, value in names]
    row = scored(device, *parts).views["view0"]
    assert list(row) == ["my_lpips", f"my_{ssim}", "my_psnr", "avge"]
    assert row["avge"] == pytest.approx(0.1)


def test_the_average_error_takes_the_first_of_each_kind() -> None:
    uses = ("ssim_skimage", "psnr", "ssim", "lpips")
    items = [
        Item(
            use,
            r.Settings(),
            HostSettings(use=use),
            Offer(METRICS, use, in_role(use), "", "", ""),
            PLACE,
        )
        for use in uses
    ]
    assert [item.name for item in averaged(items)] == ["psnr", "ssim_skimage", "lpips"]
    assert averaged(items[:3]) == ()


def test_a_metric_named_avge_keeps_its_score(device: Device) -> None:
    names = (("avge", 0.7), ("lpips", 0.2), ("ssim", 0.75), ("psnr", 20.0))
    parts = [answering(use, value, device) for use, value in names]
    assert scored(device, *parts).views["view0"]["avge"] == 0.7


def test_without_one_of_the_three_there_is_no_average_error(device: Device) -> None:
    parts = [answering("psnr", 20.0, device), answering("ssim", 0.75, device)]
    assert "avge" not in scored(device, *parts).views["view0"]
    lost = answering("lpips", r.Unavailable("no file"), device)
    assert "avge" not in scored(device, *parts, lost).views["view0"]
    proper = answering("lpips_proper", 0.2, device)
    assert "avge" not in scored(device, *parts, proper).views["view0"]


def test_the_first_test_view_is_measured_twice(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If asked, and not for views that are scored during training."""
    asked: list[int] = []

    def count(*_: Any) -> float:
        asked.append(1)
        return 0.0

    monkeypatch.setattr(Fixed, "measure", count)
    scene = tiny_scene()
    assert scene.points is not None
    model = GaussianModel(initial_gaussians(scene.points, TrainingSettings()), device)
    for repeat in (False, True):
        asked.clear()
        evaluate(model, scene, scene.train, [part("fixed", Fixed, device)], None, repeat)
        assert len(asked) == len(scene.train) + repeat
