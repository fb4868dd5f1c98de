"""The conformance suite passes good components and catches each kind of bad one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

import registry as r
from core_rasterizer import ExplainedError
from registry.testing import check

from . import toy_plugin as toys


@pytest.mark.parametrize(
    "component",
    [
        toys.ToyScene,
        toys.ToyPoints,
        toys.ToyPrior,
        toys.ToyTerm,
        toys.ToyDropout,
        toys.ToyGrowth,
        toys.ToyFade,
        toys.ToyExporter,
        toys.ToyReport,
        toys.ToyPsnr,
    ],
)
def test_the_toys_conform(component: type[r.Component[Any]]) -> None:
    check(component)


def test_metrics_may_be_unavailable_or_look_at_the_whole_view() -> None:
    check(Blind)
    check(Deep)


class Forgetful(toys.ToyTerm):
    def restore(self, state: Any) -> None:
        pass


class Unseeded(toys.ToyDropout):
    def opacity_scale(self, step: r.Step) -> torch.Tensor:
        return torch.rand(step.model.count)


class Meddler(toys.ToyFade):
    def update(self, step: r.Step) -> r.OpacityUpdate | None:
        step.model.write("opacity_logits", torch.zeros(step.model.count))  # type: ignore[attr-defined]
        return None


class Upside(toys.ToyPsnr):
    higher_is_better = False


class Blind(toys.ToyPsnr):
    """Not available, and says why."""

    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return r.Unavailable("there is no network")


class Silent(Blind):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return r.Unavailable("")


class Partial(toys.ToyPsnr):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return 1.0 if rendered.equal(photograph) else r.Unavailable("too different")


class Deep(r.ViewMetric[r.Settings]):
    """Judges depth, not colours."""

    higher_is_better = False

    def measure_view(self, rendering: Any, view: r.View, scene: r.Scene) -> float:
        assert view.depth is not None
        return float((rendering.depth - view.depth).abs().mean())


class Liar(toys.ToyExporter):
    def export(self, model: Any, scene: r.Scene, folder: Path) -> list[Path]:
        return [folder / "not-written"]


class Plain:
    """No component at all."""


class Negative(toys.ToyDropout):
    def opacity_scale(self, step: r.Step) -> torch.Tensor:
        return -torch.ones(step.model.count)


@pytest.mark.parametrize(
    ("component", "settings", "message"),
    [
        (Forgetful, {}, "restore"),
        (Unseeded, {}, "different answers"),
        (Meddler, {}, "no attribute 'write'"),
        (Upside, {}, "score better"),
        (Silent, {}, "must say why"),
        (Partial, {}, "some renders of a view only"),
        (Liar, {}, "was not written"),
        (Plain, {}, "derives from none"),
        (Negative, {}, "negative"),
        (toys.ToyTerm, {"fault": "shape"}, "expected one floating-point"),
        (toys.ToyTerm, {"fault": "gradient"}, "undefined gradient"),
        (toys.ToyGrowth, {"wrong": True}, "clone"),
        (toys.ToyFade, {"value": 2.0}, "outside"),
    ],
)
def test_faults_are_found(component: Any, settings: dict[str, Any], message: str) -> None:
    with pytest.raises((AssertionError, AttributeError, ExplainedError), match=message):
        check(component, **settings)
