"""Numbers per Gaussian that a component adds: trained, rendered, edited, resumed and exported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from plyfile import PlyData
from torch import Tensor

import registry as r
import stereogs
from core_rasterizer import Camera, Device, GaussianReader
from registry.testing import check, tiny_scene
from registry.toolkit.views import blended
from registry.training.assembly import assemble, restore
from registry.training.checkpoint import Checkpoint
from registry.training.trainer import Trainer
from tests.host import HostSettings, Item, Parts, TrainingSettings, pipeline_item, pipeline_of
from tests.registry.toy_plugin import ToyGrowth

COLUMN = 0.0
"""World x, at the wall of the tiny scene, that separates the two labels."""


def labels(camera: Camera) -> Tensor:
    """`[H, W]` int64, which side of the wall at z = 3 a pixel shows."""
    u, _ = camera.pixel_centers()
    x = (u - camera.cx) / camera.fx * 3 - camera.world_to_camera[0, 3]
    return (x > COLUMN).long()


class LabelSettings(r.Settings):
    rate: float = 0.05
    names: tuple[str, ...] = ("label",)
    wrong: str = ""


class Labels(r.Regularizer[LabelSettings]):
    """Cross entropy of two blended channels with the labels of the pixels."""

    def features(self, model: GaussianReader) -> list[r.GaussianFeature]:
        values, rate = torch.zeros(model.count, 2), self.settings.rate
        match self.settings.wrong:
            case "rows":
                values = values[1:]
            case "finite":
                values[0] = torch.nan
            case "rate":
                rate = -1.0
        learnt = [r.GaussianFeature(name, values, rate) for name in self.settings.names]
        number = torch.arange(model.count, dtype=torch.float32)[:, None]
        return [*learnt, r.GaussianFeature("number", number)]

    def loss(self, step: r.Step) -> Tensor:
        camera = step.sample.camera
        image = blended(step.model, step.features[self.settings.names[0]], camera)
        wanted = labels(camera)
        return torch.nn.functional.cross_entropy(image.flatten(0, 1), wanted.flatten())


def trainer_of(device: Device, *more: Item, iterations: int = 80) -> Trainer:
    items = pipeline_item(Labels, LabelSettings(), "labels"), *more
    settings = TrainingSettings(iterations=iterations, sh_degree=0)
    parts, scene = Parts(pipeline_of([*items], settings), device), tiny_scene()
    assert scene.points is not None
    return assemble(parts, scene, scene.points)


def growth(every: int) -> Item:
    made = pipeline_item(ToyGrowth, ToyGrowth.Settings(), "growth")
    return replace(made, host=HostSettings(use="growth", every=every, stop=40))


def test_two_channels_learn_the_labels_of_another_view(device: Device) -> None:
    trainer = trainer_of(device, growth(every=10))
    first = [d.logged["regularizers.labels"] for d in trainer.run()]
    assert first[-1] < first[0] / 2
    (field,), (view,) = trainer.fields, trainer.scene.test
    learnt = field.parameters.features["label"]
    assert len(learnt) == trainer.model.count != 60
    reader = GaussianReader(trainer.model)
    with torch.no_grad():
        image = blended(reader, learnt, view.camera)
        seen = reader.render(view.camera).alpha > 0.1
    right = (image.argmax(dim=2) == labels(view.camera))[seen]
    assert seen.float().mean() > 0.5
    assert right.float().mean() > 0.9


def test_features_follow_edits_and_resume_to_the_same_bits(device: Device) -> None:
    whole, first = (trainer_of(device, growth(every=3), iterations=12) for _ in range(2))
    list(whole.run())
    for done in first.run():
        if done.number == 7:
            break
    saved = Checkpoint(7, 0.0, first.state(), "")
    second = restore(first.parts.for_field(0), tiny_scene(), saved)
    list(second.run())
    states = whole.state(), second.state()
    assert all(torch.equal(states[0][name], value) for name, value in states[1].items())
    assert states[0].keys() == states[1].keys()
    assert states[0]["parameters/features/label/exp_avg"].any()
    fixed = states[0]["parameters/features/number/value"]
    assert len(fixed) == whole.model.count
    assert set(fixed[:, 0].tolist()) < set(range(60))
    assert len(fixed.unique()) < len(fixed)


def test_a_feature_changes_no_gaussian_unless_it_may(device: Device) -> None:
    scene = tiny_scene()
    trainer = trainer_of(device)
    reader, camera = GaussianReader(trainer.model), scene.train[0].camera
    values = torch.rand(reader.count, 5, generator=torch.Generator().manual_seed(3)) * 40 - 20
    expected = torch.zeros(camera.height, camera.width, 5)
    for channel in range(5):  # each alone, as a colour above 0
        (alone,) = blended(reader, values[:, channel : channel + 1], camera).unbind(dim=2)
        expected[..., channel] = alone
    image = blended(reader, values, camera)
    assert torch.allclose(image, expected, atol=1e-3)
    ones = blended(reader, torch.ones(reader.count, 1), camera)[..., 0]
    assert torch.allclose(ones, reader.render(camera).alpha, atol=1e-5)
    leaf = values.clone().requires_grad_()
    trainer.model.zero_gradients()
    blended(reader, leaf, camera).sum().backward()
    assert not trainer.model.gradient("means").any()
    light = blended(reader, torch.ones(reader.count, 1), camera).sum()
    assert leaf.grad is not None
    assert float(leaf.grad[:, 0].sum()) == pytest.approx(float(light.detach()), rel=1e-3)
    blended(reader, values, camera, move_gaussians=True).square().sum().backward()
    assert trainer.model.gradient("means").any()


def test_the_component_conforms() -> None:
    check(Labels)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"wrong": "rows"}, r"'label' has the shape \(59, 2\), expected \(60, channels\)"),
        ({"wrong": "finite"}, "not finite"),
        ({"wrong": "rate"}, "learning rate of 'label' is -1"),
        ({"names": ("a b",)}, "'a b' is not a word"),
        ({"names": ("scale",)}, "'scale' is a property of every PLY file"),
        ({"names": ("label", "label")}, "'label' is given twice"),
    ],
)
def test_a_wrong_feature_is_refused(device: Device, settings: dict[str, Any], what: str) -> None:
    item = pipeline_item(Labels, LabelSettings(**settings), "labels")
    parts = Parts(pipeline_of([item], TrainingSettings(iterations=1)), device)
    scene = tiny_scene()
    assert scene.points is not None
    with pytest.raises(r.PluginError, match=what) as caught:
        assemble(parts, scene, scene.points)
    assert "labels" in caught.value.where


def test_files_hold_the_features(device: Device, tmp_path: Path) -> None:
    items = [pipeline_item(Labels, LabelSettings(), "labels"), growth(every=2)]
    pipeline = pipeline_of(items, TrainingSettings(iterations=5, sh_degree=0))
    run = stereogs.train(pipeline, scene=tiny_scene(), device=device, progress=False)
    columns = PlyData.read(run.export(tmp_path / "a.ply"))["vertex"]
    number = torch.tensor(columns["number_0"])
    assert len(number) == run.model.count
    assert torch.equal(number, run.features["number_0"])
    assert {"label_0", "label_1", "number_0"} <= {p.name for p in columns.properties}
    assert torch.tensor(columns["label_1"]).any()


def test_the_hash_of_a_run_covers_the_features(device: Device) -> None:
    settings = TrainingSettings(iterations=2, sh_degree=0)

    def trained(*items: Item) -> stereogs.Run:
        return stereogs.train(
            pipeline_of([*items], settings), scene=tiny_scene(), device=device, progress=False
        )

    plain = trained()
    slow, fast = (
        trained(pipeline_item(Labels, LabelSettings(rate=rate), "labels")) for rate in (0.01, 0.05)
    )
    assert slow.engine_model.digest() == fast.engine_model.digest() == plain.hash
    assert len({plain.hash, slow.hash, fast.hash}) == 3
