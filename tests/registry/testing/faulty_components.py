"""Components with one fault each, and a few without, for the conformance suite."""

from __future__ import annotations

import json
import mmap
import os
import time
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pydantic
import torch
from torch import Tensor

import registry as r
from registry.events import IterationDone, RunEnded, RunStarted
from registry.priors import StereoPrior
from tests.registry import toy_extension_points as extension_points, toy_plugin as toys


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


OwnSettings = TypeVar("OwnSettings", bound=r.Settings)


class HalfSettings(r.Settings):
    """A value that changes when it is read back."""

    value: float = 0.0

    @pydantic.field_validator("value")
    @classmethod
    def _halve(cls, value: float) -> float:
        return value / 2


Alias = HalfSettings


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
