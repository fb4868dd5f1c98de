"""A step that does not keep gradients: the same bits as one that does, and nothing is stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch

from core_rasterizer import Adam, Device, GaussianError, GaussianModel
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import random_camera, random_scene, stored
from tests.core_rasterizer.test_optimizer import RATES
from tests.core_rasterizer.traffic import counted

CAMERA = random_camera(torch.Generator().manual_seed(2))
COUNT = 301
"""Several work-items, the last of them incomplete."""
FUSED, SEPARATE = "project_backward_and_step", "project_backward"


def make_model(device: Device) -> GaussianModel:
    scene = random_scene(torch.Generator().manual_seed(4), COUNT, spread=2)
    return GaussianModel(stored(scene), device)


class Training:
    """A model and its optimizer, and the kernels that were launched."""

    def __init__(self, device: Device, keep: bool) -> None:
        self.model, self.keep = make_model(device), keep
        self.optimizer = Adam(self.model)

    def backward(self, **options: Any) -> None:
        image = self.model.render(CAMERA, **options).rgb
        weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1)) - 0.3
        torch.autograd.backward([image], [weights])

    def step(self, degree: float = 3, **options: Any) -> None:
        self.optimizer.step(RATES, degree, keep_gradients=self.keep, **options)

    def bits(self) -> list[torch.Tensor]:
        state = self.optimizer.state()
        model = [self.model.read(name).clone() for name in PARAMETERS]
        return [*model, *state.values(), self.model.statistics.sums()]


def pair(device: Device) -> tuple[Training, Training]:
    return Training(device, True), Training(device, False)


def assert_same(kept: Training, used: Training) -> None:
    for one, other in zip(kept.bits(), used.bits(), strict=True):
        assert torch.equal(one, other)


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """Launches so far, by the kernel's name."""
    with counted(monkeypatch) as traffic:
        yield traffic.kernels


RENDERS: dict[str, dict[str, Any]] = {
    "plain": {},
    "dropout": {"opacity_scale": (torch.arange(COUNT) % 5 > 0).float()},
    "smoothing": {"smoothing": torch.full((COUNT,), 0.02)},
    "a lower degree": {"sh_degree": 1},
    "half of band 2": {"sh_degree": 1.5},
    "detached": {"detach": {"means", "sh"}},
    "statistics": {"collect_statistics": True},
    "absolute statistics": {"collect_statistics": True, "collect_absolute": True},
}


@pytest.mark.parametrize("options", RENDERS.values(), ids=RENDERS)
def test_same_bits_without_storing_gradients(
    device: Device, options: dict[str, Any], launched: Counter[str]
) -> None:
    kept, used = pair(device)
    before = used.bits()
    for training in (kept, used):
        for degree in (3, 3, 2):
            training.model.zero_gradients()
            training.backward(**(options if degree == 3 else {}))
            training.step(degree, skip=("quaternions",) if degree == 2 else ())
        assert training is used or FUSED not in launched
    assert launched[FUSED] == 3
    assert launched[SEPARATE] == 3
    assert_same(kept, used)
    assert not torch.equal(before[-3], used.bits()[-3])  # second moments


def test_a_reader_before_the_step_gets_the_gradients(
    device: Device, launched: Counter[str]
) -> None:
    kept, used = pair(device)
    for training in (kept, used):
        training.model.zero_gradients()
        training.backward()
    for name in PARAMETERS:
        gradient = used.model.gradient(name)
        assert gradient.any()
        assert torch.equal(kept.model.gradient(name), gradient)
    for training in (kept, used):
        training.step()
    assert_same(kept, used)
    assert FUSED not in launched


def test_a_parameter_written_before_the_step_does_not_change_gradients(device: Device) -> None:
    kept, used = pair(device)
    for training in (kept, used):
        training.model.zero_gradients()
        training.backward(collect_statistics=True)
        if training.keep:
            training.model.gradient("means")
        training.model.write("opacity_logits", 0.9 * training.model.read("opacity_logits"))
        training.step()
    assert_same(kept, used)


def test_passes_and_losses_on_parameters_add_up(device: Device) -> None:
    kept, used = pair(device)
    for training in (kept, used):
        for _ in range(2):
            training.model.zero_gradients()
            training.backward()
            training.backward(sh_degree=1)
            training.model.parameter("scales").sum().backward()
            training.step()
    assert_same(kept, used)


def test_reading_after_the_step_is_an_error(device: Device) -> None:
    kept, used = pair(device)
    for training in (kept, used):
        training.model.zero_gradients()
        training.backward()
        training.step()
    assert kept.model.gradient("means").any()
    with pytest.raises(GaussianError, match="the gradients are gone"):
        used.model.gradient("means")
    with pytest.raises(GaussianError, match="the gradients are gone"):
        used.model.touched()
    with pytest.raises(GaussianError, match="the gradients are gone"):
        used.step()
    for training in (kept, used):
        training.model.zero_gradients()
        assert not training.model.gradient("means").any()
        training.backward()
        training.step()
    assert_same(kept, used)


def test_statistics_survive_passes_that_take_no_step(device: Device) -> None:
    kept, used = pair(device)
    for training in (kept, used):
        for _ in range(2):
            training.model.zero_gradients()
            training.backward(collect_statistics=True)
    assert torch.equal(kept.model.statistics.sums(), used.model.statistics.sums())
    used.model.zero_gradients()
    assert used.model.statistics.sums()[1].max() == 2


def test_the_states_of_an_iteration(device: Device) -> None:
    """As the diagram of `Gradients` has them."""
    used, states = Training(device, False), []
    gradients = used.model.gradients
    actions: list[Callable[[], object]] = [
        used.model.zero_gradients,
        used.backward,
        used.step,
        used.backward,
        used.backward,
        lambda: used.model.gradient("means"),
        used.step,
        lambda: used.model.parameter("scales").sum().backward(),
        used.step,
    ]
    for act in actions:
        act()
        states.append(gradients.state.name)
    first, second = ["ZERO", "DEFERRED", "USED"], ["DEFERRED", "DEFERRED_MORE", "STORED", "USED"]
    assert states == [*first, *second, "ZERO", "USED"]
    assert gradients.passes == 4
