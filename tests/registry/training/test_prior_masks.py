"""Masks from priors lower the weights of training pixels; a moving object that is masked spoils nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

import stereogs
from core_rasterizer import Device
from registry import PluginError, Prior, Scene, Settings
from registry.priors import MaskPrior
from registry.testing import check, tiny_scene
from registry.training.assembly import assemble, restore
from registry.training.checkpoint import Checkpoint
from registry.training.prior_masks import with_prior_masks
from tests.host import Item, Parts, Pipeline, TrainingSettings, pipeline_item, pipeline_of

INTRUDER = torch.tensor([1.0, 0.0, 1.0])
"""Colour of an object that is at another place in each photograph."""


class FindIntruder(MaskPrior[Settings]):
    """Leaves out pixels of the intruder's colour, as a network would leave out people."""

    calls = 0

    def estimate(self, image: Tensor) -> Tensor:
        type(self).calls += 1
        return (image - INTRUDER).abs().amax(dim=2) > 0.01


class WrongSettings(Settings):
    answer: str = "large"


class Wrong(MaskPrior[WrongSettings]):
    def estimate(self, image: Tensor) -> Tensor:
        match self.settings.answer:
            case "large":
                return torch.full(image.shape[:2], 2.0)
            case "shape":
                return torch.ones(3)
            case "nan":
                return torch.full(image.shape[:2], torch.nan)
        return torch.zeros(image.shape[:2])


def disturbed() -> Scene:
    """The tiny scene with an object that the first and the last photograph show at different places."""
    scene = tiny_scene()
    views = []
    for number, view in enumerate(scene.train):
        image = view.image.clone()
        image[6:18, 6 + 10 * number : 14 + 10 * number] = INTRUDER
        views.append(replace(view, image=image))
    return replace(scene, train=tuple(views))


def pipeline(*priors: Item, iterations: int = 150) -> Pipeline:
    training = TrainingSettings(
        iterations=iterations, sh_degree=0, checkpoint_every=iterations // 2
    )
    return pipeline_of([*priors], training)


def prior(kind: type[Prior[Settings]] = FindIntruder, name: str = "people") -> Item:
    return pipeline_item(kind, kind.Settings(), name)


def error(run: stereogs.Run) -> float:
    """Mean error of the test view, which the object does not disturb."""
    return run.scores["test"].mean["mean_error"] or 0.0


def test_a_masked_object_does_not_spoil_the_rest(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    scene = disturbed()

    def trained(scene: Scene, *priors: Item) -> stereogs.Run:
        return stereogs.train(pipeline(*priors), scene=scene, device=device, progress=False)

    clean, plain, calls = trained(tiny_scene()), trained(scene), FindIntruder.calls
    masked = trained(scene, prior())
    assert FindIntruder.calls == calls + 2
    assert error(masked) - error(clean) < 0.3 * (error(plain) - error(clean))
    again = trained(scene, prior())
    assert FindIntruder.calls == calls + 2  # from the cache
    assert again.hash == masked.hash
    assert all(view.weights is None for view in masked.scene.train)
    for seen in (masked.trained.scene, masked.trained_on.for_training()):  # confidence and reports
        for view in seen.train:
            assert view.weights is not None
            assert (view.image - INTRUDER).abs().amax(dim=2).min() > 0.01
    assert FindIntruder.calls == calls + 2


def test_scores_count_the_object(device: Device) -> None:
    run = stereogs.train(
        pipeline(prior(), iterations=6), scene=disturbed(), device=device, progress=False
    )
    scores = run.scores["train"].mean["mean_error"]
    assert scores is not None
    assert scores > error(run)  # the photographs show the object, the render does not


def test_a_resumed_training_has_the_masks(device: Device) -> None:
    parts, scene = Parts(pipeline(prior(), iterations=6), device), disturbed()
    assert scene.points is not None
    whole, half = (
        assemble(parts.for_field(0), with_prior_masks(scene, parts), scene.points) for _ in "ab"
    )
    list(whole.run())
    for done in half.run():
        if done.number == 3:
            break
    resumed = restore(parts.for_field(0), scene, Checkpoint(3, 0.0, half.state(), ""))
    list(resumed.run())
    assert resumed.model.digest() == whole.model.digest()


def test_masks_multiply_the_weights_of_files(device: Device) -> None:
    scene = disturbed()
    first, second = scene.train
    half = torch.full(first.image.shape[:2], 0.5)
    half[:3] = 0
    parts = Parts(pipeline(prior(), prior(name="again")), device)
    masked = with_prior_masks(replace(scene, train=(replace(first, weights=half), second)), parts)
    found = masked.train[0].weights
    assert found is not None
    assert found.unique().tolist() == [0, 0.5]
    assert not found[6:18, 6:14].any()
    assert not found[:3].any()
    (trained, _) = masked.for_training().train
    assert (trained.image - INTRUDER).abs().amax(dim=2).min() > 0.01
    clean = with_prior_masks(tiny_scene(), parts)
    assert all(view.weights is None for view in clean.train)


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        ("large", "the mask is 2 to 2, not 0 to 1"),
        ("shape", r"the mask is \(3,\)"),
        ("nan", "not finite"),
    ],
)
def test_the_conformance_suite_refuses_wrong_masks(answer: str, what: str) -> None:
    check(FindIntruder)
    with pytest.raises(PluginError, match=what):
        check(Wrong, answer=answer)


def test_a_photograph_without_pixels_is_refused(device: Device) -> None:
    item = pipeline_item(Wrong, WrongSettings(answer="zero"), "wrong")
    with pytest.raises(PluginError, match="leaves no pixel of 'view0'") as caught:
        stereogs.train(pipeline(item), scene=tiny_scene(), device=device, progress=False)
    assert "wrong" in caught.value.where


def test_a_view_of_less_weight_counts_less(device: Device) -> None:
    """A generated view, here of a wrong colour, with one weight for all its pixels."""
    scene = tiny_scene()
    first, second = scene.train
    wrong = replace(second, name="generated.png", image=1 - second.image)

    def trained(weight: float) -> float:
        generated = replace(wrong, weights=torch.full(wrong.image.shape[:2], weight))
        views = replace(scene, train=(first, generated))
        run = stereogs.train(pipeline(iterations=60), scene=views, device=device, progress=False)
        return error(run)

    assert trained(0.05) < trained(1.0)
