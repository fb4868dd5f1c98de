"""The conformance suite passes good components and catches each kind of bad one."""

from __future__ import annotations

import importlib
import json
import mmap
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import pytest
import torch
from torch import Tensor

import registry as r
from core_rasterizer import ExplainedError
from registry.events import IterationDone, RunEnded, RunStarted
from registry.priors import StereoPrior
from registry.testing import check
from tests.registry import toy_extension_points as extension_points, toy_plugin as toys
from tests.registry.conftest import Install


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
    check(Blind)
    check(Deep)


def test_a_metric_need_not_compare_images() -> None:
    check(Bright)


def test_a_report_may_read_every_file_of_a_run() -> None:
    check(Reader)


def test_a_component_may_refuse_degenerate_inputs_with_an_explanation() -> None:
    check(NeedsWindow)


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
            settings: HalfSettings

    assert "class Ignored(Regularizer[HalfSettings])" in caught.value.fix

    class Repeated(r.Regularizer[HalfSettings]):
        settings: HalfSettings

    assert Repeated.Settings is HalfSettings


def test_check_returns_the_cost() -> None:
    cost = check(Slow)
    assert 0.05 < cost.seconds < 60
    assert cost.megabytes is None or cost.megabytes > 50
    assert str(cost).startswith(f"{cost.seconds:.3f} s")


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
    """Not available, with a reason."""

    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return r.Unavailable("there is no network")


class Silent(Blind):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return r.Unavailable("")


class Partial(toys.ToyPsnr):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        return 1.0 if rendered.equal(photograph) else r.Unavailable("too different")


class Deep(r.ViewMetric[r.Settings]):
    """Compares depth, not colours."""

    higher_is_better = False

    def measure_view(self, rendering: Any, view: r.View, scene: r.Scene) -> float:
        assert view.depth is not None
        return float((rendering.depth - view.depth).abs().mean())


class Liar(toys.ToyExporter):
    def export(self, model: Any, scene: r.Scene, folder: Path) -> list[Path]:
        return [folder / "not-written"]


class Bright(toys.ToyPsnr):
    """Reads the render alone."""

    equal_images_are_best = False

    def measure(self, rendered: Any, photograph: Any, mask: Any) -> float:
        return float(rendered.mean())


class Reader(toys.ToyReport):
    """Reads the log of training, the pipeline and the renders of the test views."""

    def write(self, folder: Path, scene: r.Scene) -> list[Path]:
        lines = (folder / "metrics.jsonl").read_text("utf-8").splitlines()
        assert json.loads(lines[-1])["photometric"] > 0
        results = json.loads((folder / "results.json").read_text("utf-8"))
        for view in results["views"]["test"]:
            assert (folder / "renders" / f"{view}.png").is_file()
        assert "under_test" not in (folder / "pipeline.yaml").read_text("utf-8")
        return super().write(folder, scene)


class NeedsWindow(toys.ToyPsnr):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> Any:
        if rendered.shape[0] < 7:
            raise r.PluginError("the image is smaller than the window", fix="use larger images")
        return super().measure(rendered, photograph, mask)


class Slow(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        if step.view.camera.width > 100:
            with mmap.mmap(-1, 80_000_000) as pages:  # new pages: an allocator may reuse freed ones
                pages.write(bytes([1]) * 80_000_000)
                time.sleep(0.06)
        return super().loss(step)


class Plain:
    """Not a component."""


class Negative(toys.ToyDropout):
    def opacity_scale(self, step: r.Step) -> torch.Tensor:
        return -torch.ones(step.model.count)


class Counting(toys.ToyTerm):
    """Ten times its usual weight in every fifth call."""

    def __init__(self, settings: Any, context: r.Context) -> None:
        super().__init__(settings, context)
        self.count = 0

    def loss(self, step: r.Step) -> torch.Tensor:
        self.count += 1
        return super().loss(step) * (10 if self.count % 5 == 0 else 1)


class Remembering(r.OpacityPolicy[r.Settings]):
    """Fades each Gaussian by its age."""

    def __init__(self, settings: Any, context: r.Context) -> None:
        super().__init__(settings, context)
        self.age = torch.zeros(0)

    def update(self, step: r.Step) -> r.OpacityUpdate:
        if len(self.age) != step.model.count:
            self.age = torch.arange(step.model.count).float()
        self.age += 1
        return r.OpacityUpdate(step.model.opacities() * 0.999**self.age)

    def state(self) -> dict[str, torch.Tensor]:
        return {"age": self.age}

    def restore(self, state: Any) -> None:
        self.age = state["age"].clone()


class Late(Remembering):
    """Drops the last rows instead of those that were pruned."""

    def carry(self, source: torch.Tensor, fresh: torch.Tensor) -> None:
        new = torch.zeros(max(0, len(source) - len(self.age)))
        self.age = torch.cat([self.age, new])[: len(source)]


class Rigid(Remembering):
    def update(self, step: r.Step) -> r.OpacityUpdate:
        if not len(self.age):
            self.age = torch.zeros(step.model.count)
        self.age += 1
        return r.OpacityUpdate((step.model.opacities() + self.age).clamp(max=1))


class Painter(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        step.view.image.mul_(0.5)
        return super().loss(step)


class Borrower(toys.ToyPsnr):
    def measure(self, rendered: Any, photograph: Any, mask: Any) -> float:
        rendered.copy_(photograph)
        return super().measure(rendered, photograph, mask)


class Overwriting(toys.ToyReport):
    def write(self, folder: Path, scene: r.Scene) -> list[Path]:
        (folder / "results.json").write_text("{}", "utf-8")
        return super().write(folder, scene)


class Trainer(toys.ToyExporter):
    def export(self, model: Any, scene: r.Scene, folder: Path) -> list[Path]:
        model.write("means", torch.zeros(model.count, 3))
        return super().export(model, scene, folder)


class Replacing(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        answer = super().loss(step)
        step.iteration += 1  # type: ignore[misc]
        return answer


class Seeding(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        torch.manual_seed(0)
        return super().loss(step)


class NumpyNoise(toys.ToyDropout):
    def opacity_scale(self, step: r.Step) -> torch.Tensor:
        return torch.from_numpy(np.random.rand(step.model.count))


class Switching(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        answer = super().loss(step)
        torch.set_grad_enabled(False)
        return answer


class Constant(toys.ToyTerm):
    def loss(self, step: r.Step) -> torch.Tensor:
        return step.model.scales().mean()


class Cut(extension_points.ToyExposure):
    def colors(self, step: r.Step, rgb: torch.Tensor) -> torch.Tensor:
        return super().colors(step, rgb).detach()


class Dividing(toys.ToyTerm):
    """Not a number where nothing is seen."""

    def loss(self, step: r.Step) -> torch.Tensor:
        seen = step.rendering.alpha > 0.01
        return step.rendering.alpha[seen].mean()


class Stubborn(toys.ToyPsnr):
    """Needs more than one pixel and does not say so."""

    def measure(self, rendered: Any, photograph: Any, mask: Any) -> float:
        return -abs(float(rendered[1, 1, 2]) - float(photograph[1, 1, 2]))


class Squeezing(StereoPrior):
    """Returns another shape for images of one pixel."""

    def estimate(self, left: Any, right: Any) -> torch.Tensor:
        return left.mean(dim=2) if left.shape[1] > 1 else torch.zeros(2, 2)


class HalfSettings(r.Settings):
    """A value that changes when it is read back."""

    value: float = 0.0

    @pydantic.field_validator("value")
    @classmethod
    def _halve(cls, value: float) -> float:
        return value / 2


class Halving(r.Regularizer[HalfSettings]):
    def loss(self, step: r.Step) -> torch.Tensor:
        return step.rendering.alpha.mean()


class Misspelled(r.Observer):
    """Misspells the name of an event."""

    def iteration(self, done: IterationDone) -> None:
        pass


class Retouching(toys.ToyDiary):
    def iterated(self, done: IterationDone) -> None:
        done.rendering.rgb.clamp_(0, 0.5)


class Impatient(toys.ToyDiary):
    def ended(self, run: RunEnded) -> None:
        if run.error:
            raise ValueError("no results")


class Once(toys.ToyDiary):
    def started(self, run: RunStarted) -> None:
        super().started(run)
        assert not run.resumed, "it has started before"


class Ordered(toys.ToyTerm):
    def loss(self, step: r.Step) -> Tensor:
        return super().loss(step) * (1 + list({"a", "b", "c", "d", "e"}).index("a"))


class Numbered(toys.ToyTerm):
    def loss(self, step: r.Step) -> Tensor:
        return super().loss(step) * (1 + os.getpid() % 1000)


class ListState(toys.ToyTerm):
    def state(self) -> Any:
        return {"calls": [1.0]}


class MetaState(toys.ToyTerm):
    def state(self) -> Any:
        return {"calls": torch.empty(1, device="meta")}


@pytest.mark.parametrize(
    ("component", "settings", "message"),
    [
        (Forgetful, {}, "restore"),
        (Unseeded, {}, "torch's global generator"),
        (Meddler, {}, "no attribute 'write'"),
        (Upside, {}, "score better"),
        (Silent, {}, "must say why"),
        (Partial, {}, "some renders of a view only"),
        (Liar, {}, "no such file"),
        (Plain, {}, "derives from none"),
        (Negative, {}, "negative"),
        (toys.ToyTerm, {"fault": "shape"}, "expected one floating-point"),
        (toys.ToyTerm, {"fault": "gradient"}, "undefined gradient"),
        (toys.ToyGrowth, {"wrong": True}, "clone"),
        (toys.ToyFade, {"value": 2.0}, "outside"),
        (Counting, {}, r"resumed after iteration \d+ differs .* does state\(\) return"),
        (Remembering, {}, r"has \d+ rows after Gaussians were cloned, expected \d+"),
        (Late, {}, "another Gaussian's row"),
        (Rigid, {}, "must match the size"),
        (Painter, {}, r"changed what it was given: step.scene.train\[0\].image"),
        (Borrower, {}, r"changed what it was given: argument 1.rgb"),
        (Overwriting, {}, r"changed what it was given: .*run/results.json"),
        (Trainer, {}, "no attribute 'write'"),
        (Replacing, {}, "cannot assign to field 'iteration'"),
        (Seeding, {}, "torch's global generator"),
        (NumpyNoise, {}, "numpy's global generator"),
        (Switching, {}, "torch's gradient mode"),
        (Constant, {}, "would change nothing"),
        (Cut, {}, "cut off from autograd"),
        (Dividing, {}, "the loss is not finite"),
        (Stubborn, {}, "out of bounds"),
        (Squeezing, {}, r"expected a tensor of shape \(1, 1\)"),
        (Halving, {"value": 1.0}, "do not survive being written as JSON"),
        (ListState, {}, "which no checkpoint can hold"),
        (MetaState, {}, "which no checkpoint can hold"),
        (Misspelled, {}, "the observer handles no event: define one of started, iterated"),
        (Retouching, {}, "changed what it was given: argument 1.rendering.rgb"),
        (Impatient, {}, "no results"),
        (Once, {}, "AssertionError: it has started before"),
    ],
)
def test_faults_are_found(component: Any, settings: dict[str, Any], message: str) -> None:
    kinds = (AssertionError, AttributeError, IndexError, ValueError, ExplainedError)
    with pytest.raises(kinds, match=re.compile(message, re.DOTALL)):
        check(component, **settings)


@pytest.mark.proof
def test_answers_that_depend_on_the_process_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("registry.testing.processes.SEEDS", ("1", "2"))
    for component in (Ordered, Numbered):
        with pytest.raises(AssertionError, match="two processes gave different answers"):
            check(component)
