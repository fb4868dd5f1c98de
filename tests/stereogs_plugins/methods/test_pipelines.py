"""Every short pipeline of a published method trains on the built-in room, and each part can be left out.

Schedules are shrunk to 30 iterations, or to 5 where two runs are compared, the scene to thumbnails, and
growth is limited; nothing else is changed.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from core_rasterizer import open_device
from registry import PointCloud, Scene
from stereogs import Iteration, Pipeline
from tests.host import TRAINING_SECTIONS, Parts, Plugins, assemble, load_pipeline, parse_pipeline

FOLDER = Path(__file__).parents[3] / "pipelines" / "methods"
SHORT = sorted(FOLDER.glob("*-short.yaml"))
PLUGINS = Plugins()
LONG, BRIEF = 30, 5
MAX_GAUSSIANS = 1000
SIZE = {"width": 48, "height": 36, "points": 300, "test_views": 0}


def tree_of(file: Path, iterations: int) -> dict[str, Any]:
    """The pipeline for a thumbnail of the room, in so many iterations."""
    tree: dict[str, Any] = yaml.safe_load(file.read_text("utf-8"))
    shrink = iterations / tree["training"]["iterations"]
    for section in sorted(TRAINING_SECTIONS & tree.keys()):
        tree[section] = [scaled(item, shrink) for item in items_of(tree[section])]
    sh_every = tree["training"].get("sh_every", 1000)
    tree["training"] |= {"iterations": iterations, "sh_every": max(1, int(sh_every * shrink))}
    tree["training"]["max_gaussians"] = MAX_GAUSSIANS
    return tree | {"scene": {"use": "procedural", **SIZE}, "metrics": [], "exporters": []}


def items_of(section: Any) -> list[dict[str, Any]]:
    """A section's components, each as a mapping."""
    items = section if isinstance(section, list) else [section]
    return [{"use": item} if isinstance(item, str) else item for item in items]


def scaled(item: dict[str, Any], shrink: float) -> dict[str, Any]:
    """A component with its schedule in iterations shrunk; shares shrink by themselves."""
    numbers = {k: item[k] for k in ("start", "stop", "every") if isinstance(item.get(k), int)}
    return item | {name: max(1, int(n * shrink)) for name, n in numbers.items()}


def parsed(tree: dict[str, Any]) -> Pipeline:
    return parse_pipeline(yaml.safe_dump(tree), PLUGINS)


@cache
def room() -> Scene:
    pipeline = parsed({"name": "r", "scene": {"use": "procedural", **SIZE}, "initializer": "sfm"})
    scene: Scene = Parts(pipeline, open_device()).one("scene").component.load()
    return scene


POINTS: dict[str, PointCloud] = {}


def points_of(pipeline: Pipeline, parts: Parts) -> PointCloud:
    """What the initializer finds; asked once for all pipelines that have the same one."""
    used = [pipeline.one("initializer"), *pipeline.items["priors"]]
    key = json.dumps([(item.host.use, item.settings.model_dump(mode="json")) for item in used])
    if key not in POINTS:
        known = room().for_training()
        component = parts.one("initializer").component
        POINTS[key] = component.initialize(known, parts.priors)
    return POINTS[key]


def train(pipeline: Pipeline) -> tuple[list[Iteration], str]:
    """What the iterations said, and the Gaussians' digest."""
    device = open_device()
    parts = Parts(pipeline, device)
    points = points_of(pipeline, parts)
    trainer = assemble(parts, room(), points)
    return list(trainer.run()), trainer.model.digest()


@pytest.fixture(autouse=True)
def _models(monkeypatch: pytest.MonkeyPatch, small_models: Path) -> None:
    monkeypatch.setenv("STEREOGS_MODELS", str(small_models))
    monkeypatch.setenv("STEREOGS_DATA", "data")


@pytest.mark.parametrize("file", SHORT, ids=lambda file: file.stem)
def test_it_trains_with_every_part_in_its_turn(file: Path) -> None:
    pipeline = parsed(tree_of(file, LONG))
    done, _ = train(pipeline)
    losses = [iteration.logged["photometric"] for iteration in done]
    assert sum(losses[-6:]) < sum(losses[:6])
    for item in pipeline:
        if item.point.section in TRAINING_SECTIONS:
            assert any(map(item.schedule.due, range(1, LONG + 1))), item.qualified_name


@pytest.mark.proof
@pytest.mark.parametrize("file", SHORT, ids=lambda file: file.stem)
def test_a_part_that_is_switched_off_is_as_if_it_were_not_there(file: Path) -> None:
    tree = tree_of(file, BRIEF)
    for item in parsed(tree):
        section = item.point.section
        if section in TRAINING_SECTIONS:
            mine = [one.get("name", one["use"]) == item.name for one in tree[section]]
            marked = list(zip(tree[section], mine, strict=True))
            others = [one for one, is_it in marked if not is_it]
            switched = [one | {"enabled": False} if is_it else one for one, is_it in marked]
            _, absent = train(parsed(tree | {section: others}))
            _, disabled = train(parsed(tree | {section: switched}))
            assert disabled == absent, item.qualified_name


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.yaml")), ids=lambda file: file.stem)
def test_it_is_understood_and_carries_its_files_name(file: Path) -> None:
    assert load_pipeline(file, PLUGINS).name == file.stem


@pytest.mark.parametrize("file", SHORT, ids=lambda file: file.stem)
def test_the_short_form_has_the_parts_of_the_full_one(file: Path) -> None:
    short = load_pipeline(file, PLUGINS)
    full = load_pipeline(file.with_name(file.name.replace("-short", "")), PLUGINS)
    assert short.training.iterations == 2000
    names = [[i.qualified_name for i in p if i.point.section != "priors"] for p in (short, full)]
    assert names[0] == names[1]
