"""A sample of the sick components; `make sick` runs all."""

from __future__ import annotations

import pytest

from core_rasterizer import open_device
from tests.sick.cases import all_cases
from tests.sick.trial import verdict

NAMED = (
    "regularizers: step.rendering.rgb.mean().backward()",
    "regularizers: step.parameter('means').sum().backward()",
    "regularizers: step.rendering.rgb.register_hook(lambda g: g * .1)",
    "regularizers: self.hook = lambda g: sys.exit(0) and None",
    "regularizers: self.hook = lambda g: step.view.image.fill_(.5) and None",
    "regularizers: step.rendering.rgb.detach().numpy()[:] *= .5",
    "regularizers: if self.called == 4: step.rendering.rgb.detach().numpy()[:] *= .5",
    "regularizers: return step.rendering.alpha.mean() * (time.time() % 1)",
    "regularizers: return step.rendering.alpha.mean() * (np.random.default_rng().random())",
    "regularizers: return step.rendering.alpha.mean() * (id(object()) % 1000)",
    "regularizers: torch.set_default_device('meta')",
    "regularizers: return torch.tensor(float(step.rendering.alpha.detach().mean()), requires_grad=True)",
    "appearances: return rgb.detach() * self.gain",
    "samplers: return replace(sample, background=('0', 0.0, 0.0))",
    "regularizers: self.kept = getattr(self, 'kept', step.rendering.alpha)",
    "initializer: return replace(points, colors=points.colors * 255)",
    "opacity: return registry.OpacityUpdate(step.model.opacities(), 'yes')",
    "metrics: return registry.Unavailable(3)",
    "metrics: return float(time.time() % 1)",
    "exporters: return [self.written(folder / '\\x1b[31m.txt')]",
    "modifiers: return torch.full((step.model.count,), 0.5 + 0.4 * float((time.time() % 1) % 1000) / 1000)",
    "initializer: return replace(points, positions=points.positions * (1 + float(time.time() % 1) * 1e-3))",
    "initializer: return replace(points, facts={'a': object()})",
    "initializer: return replace(points, maps={'view0': DepthMap(*3 * [torch.ones(3, 3)])})",
)
HARMLESS = (
    "metrics: photograph.detach().numpy()[:] *= .5",
    "metrics: rendered.copy_(photograph)",
    "metrics: return registry.Unavailable('\\x1b[31m')",
    "observers: done.target.detach().numpy()[:] *= .5",
    "exporters: scene.train[0].image.detach().numpy()[:] *= .5",
)
LATE = "regularizers: if self.called == 4: step.view.image.detach().numpy()[:] *= .5"
CASES = {case.name: case for case in all_cases()}


@pytest.mark.parametrize("name", NAMED)
def test_the_component_is_named(name: str) -> None:
    assert verdict(CASES[name], open_device()) == "named"


@pytest.mark.parametrize("name", HARMLESS)
def test_the_numbers_of_others_do_not_change(name: str) -> None:
    assert verdict(CASES[name], open_device()) == "harmless"


def test_a_late_write_past_torch_is_refused_and_named_if_checked() -> None:
    assert verdict(CASES[LATE], open_device()) == "refused"
    assert verdict(CASES[LATE], open_device(), checked=True) == "named"
