"""The conformance suite passes good components and catches each kind of bad one."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

import registry as r
from core_rasterizer import ExplainedError
from registry.testing import check
from tests.registry import toy_extension_points as extension_points, toy_plugin as toys
from tests.registry.conftest import Install
from tests.registry.testing import faulty_components as faulty


@pytest.mark.parametrize(
    "component",
    [
        toys.ToyTerm,
        toys.ToyDropout,
        toys.ToyGrowth,
        toys.ToyFade,
        toys.ToyExporter,
        toys.ToyReport,
        toys.ToyPsnr,
        toys.ToyDiary,
        extension_points.ToyExposure,
    ],
)
def test_the_toys_conform(component: type[r.Component[Any]]) -> None:
    """The faulty components below derive from these."""
    check(component)


def test_metrics_may_be_unavailable_or_read_the_whole_view() -> None:
    check(faulty.Blind)
    check(faulty.Deep)


def test_a_metric_need_not_compare_images() -> None:
    check(faulty.Bright)


def test_a_report_may_read_every_file_of_a_run() -> None:
    check(faulty.Reader)


def test_a_component_may_refuse_degenerate_inputs_with_an_explanation() -> None:
    check(faulty.NeedsWindow)


def test_an_entry_point_with_another_name_is_an_error(install: Install) -> None:
    source = (
        Path(toys.__file__)
        .read_text("utf-8")
        .replace("from . import", "from tests.registry import")
    )
    install("misnamed", "1", {"toy_therm": "misnamed_a"}, misnamed_a=source)
    component = importlib.import_module("misnamed_a").ToyTerm
    with pytest.raises(r.PluginError, match="no entry point of misnamed"):
        check(component)


def test_the_thread_of_the_host_is_not_attributed_to_the_component() -> None:
    """In a new process: the first watched call starts the host's thread."""
    code = (
        "from tests.registry.toy_plugin import ToyTerm\n"
        "from registry.testing import check, processes\n"
        "processes.SEEDS = ()\n"
        "import logging\nlogging.basicConfig(level='WARNING')\n"
        "check(ToyTerm)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200)
    assert "left a thread running" not in done.stderr


class Labels(r.Prior[r.Settings]):
    """A capability of its own; one of its methods fails."""

    capability = "labels"

    def labels(self, view: r.TrainingView) -> torch.Tensor:
        return (view.image.mean(dim=2) > 0.5).float()

    def broken(self, view: r.TrainingView) -> torch.Tensor:
        raise AttributeError("no such layer")


def ask(prior: Labels, scene: r.Scene) -> torch.Tensor:
    return prior.labels(scene.train[0])


def test_a_prior_of_another_capability_passes_only_if_it_was_called() -> None:
    check(Labels, call=ask)
    with pytest.raises(AssertionError, match=r"'labels' is its own.*check\(Labels, call="):
        check(Labels)
    with pytest.raises(AttributeError, match="no such layer"):
        check(Labels, call=lambda prior, scene: prior.broken(scene.train[0]))


def test_an_annotation_of_settings_that_would_be_ignored_is_refused() -> None:
    with pytest.raises(r.PluginError, match="annotates `settings` as HalfSettings") as caught:

        class Ignored(r.Regularizer):
            settings: faulty.HalfSettings

    assert "class Ignored(Regularizer[HalfSettings])" in caught.value.fix

    class Repeated(r.Regularizer[faulty.HalfSettings]):
        settings: faulty.HalfSettings

    assert Repeated.Settings is faulty.HalfSettings


def test_other_annotations_of_settings_are_accepted() -> None:
    class Generic(r.Regularizer[faulty.OwnSettings]):
        settings: faulty.OwnSettings

    class Widened(r.Regularizer[faulty.HalfSettings]):
        settings: faulty.HalfSettings | r.Settings  # type: ignore[assignment]

    class Renamed(r.Regularizer[faulty.HalfSettings]):
        settings: faulty.Alias

    class Later(r.Regularizer[faulty.HalfSettings]):
        settings: NotYetKnown  # type: ignore[name-defined]  # noqa: F821

    assert Widened.Settings is Renamed.Settings is Later.Settings is faulty.HalfSettings
    assert Generic.Settings is r.Settings


def test_check_returns_the_cost() -> None:
    cost = check(faulty.Slow)
    assert 0.05 < cost.seconds < 60
    assert cost.megabytes is None or cost.megabytes > 50
    assert str(cost).startswith(f"{cost.seconds:.3f} s")


@pytest.mark.parametrize(
    ("component", "settings", "message"),
    [
        (faulty.Forgetful, {}, "restore"),
        (faulty.Unseeded, {}, "torch's global generator"),
        (faulty.Meddler, {}, "no attribute 'write'"),
        (faulty.Upside, {}, "score better"),
        (faulty.Silent, {}, "must say why"),
        (faulty.Partial, {}, "some renders of a view only"),
        (faulty.Liar, {}, "no such file"),
        (faulty.Plain, {}, "derives from none"),
        (faulty.Negative, {}, "negative"),
        (toys.ToyTerm, {"fault": "shape"}, "expected one floating-point"),
        (toys.ToyTerm, {"fault": "gradient"}, "undefined gradient"),
        (toys.ToyGrowth, {"wrong": True}, "clone"),
        (toys.ToyFade, {"value": 2.0}, "outside"),
        (faulty.Counting, {}, r"resumed after iteration \d+ differs .* does state\(\) return"),
        (faulty.Remembering, {}, r"has \d+ rows after Gaussians were cloned, expected \d+"),
        (faulty.Late, {}, "another Gaussian's row"),
        (faulty.Rigid, {}, "must match the size"),
        (faulty.Painter, {}, r"changed what it was given: step.scene.train\[0\].image"),
        (faulty.Borrower, {}, r"changed what it was given: argument 1.rgb"),
        (faulty.Overwriting, {}, r"changed what it was given: .*run/results.json"),
        (faulty.Trainer, {}, "no attribute 'write'"),
        (faulty.Replacing, {}, "cannot assign to field 'iteration'"),
        (faulty.Seeding, {}, "torch's global generator"),
        (faulty.NumpyNoise, {}, "numpy's global generator"),
        (faulty.Switching, {}, "torch's gradient mode"),
        (faulty.Constant, {}, "would change nothing"),
        (faulty.Cut, {}, "cut off from autograd"),
        (faulty.Dividing, {}, "the loss is not finite"),
        (faulty.Stubborn, {}, "out of bounds"),
        (faulty.Squeezing, {}, r"expected a tensor of shape \(1, 1\)"),
        (faulty.Halving, {"value": 1.0}, "do not survive being written as JSON"),
        (faulty.ListState, {}, "which no checkpoint can hold"),
        (faulty.MetaState, {}, "which no checkpoint can hold"),
        (faulty.Misspelled, {}, "the observer handles no event: define one of started, iterated"),
        (faulty.Retouching, {}, "changed what it was given: argument 1.rendering.rgb"),
        (faulty.Impatient, {}, "no results"),
        (faulty.Once, {}, "AssertionError: it has started before"),
    ],
)
def test_faults_are_found(component: Any, settings: dict[str, Any], message: str) -> None:
    kinds = (AssertionError, AttributeError, IndexError, ValueError, ExplainedError)
    with pytest.raises(kinds, match=re.compile(message, re.DOTALL)):
        check(component, **settings)


@pytest.mark.proof
def test_answers_that_depend_on_the_process_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("registry.testing.processes.SEEDS", ("1", "2"))
    for component in (faulty.Ordered, faulty.Numbered):
        with pytest.raises(AssertionError, match="two processes gave different answers"):
            check(component)
