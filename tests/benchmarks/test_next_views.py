from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from benchmarks import next_views
from benchmarks.next_views import RecordedSets, read_records
from benchmarks.next_views_page import Measured, interval, summary, table
from benchmarks.next_views_rules import RULES
from benchmarks.next_views_scenes import SCENES, PoolScene
from core_rasterizer import Camera
from registry import Scene, View


def pool(places: tuple[float, ...]) -> PoolScene:
    """A pool of cameras on a line, and a test view."""
    views = []
    for number, x in enumerate((*places, 0.5)):
        pose = torch.eye(4)
        pose[0, 3] = -x
        camera = Camera.centered(pose, 50.0, 6, 4)
        views.append(View(str(number), camera, torch.full((4, 6, 3), 0.5)))
    return PoolScene("line", Scene("line", tuple(views[:-1]), (views[-1],), (1.0, 9.0)))


def test_a_set_trains_on_its_photographs_in_the_order_of_the_pool() -> None:
    scene = pool((0.0, 1.0, 2.0, 3.0, 4.0)).of((4, 0, 1))
    assert [view.name for view in scene.train] == ["0", "1", "4"]
    assert [view.name for view in scene.test] == ["5"]


def test_the_start_is_evenly_spaced() -> None:
    assert pool(tuple(map(float, range(9)))).start == (0, 4, 8)


@pytest.mark.parametrize(
    ("rule", "expected"),
    [("longest gap", 3), ("farthest", 2)],
)
def test_rules_choose_by_order_or_by_distance(rule: str, expected: int) -> None:
    scene = pool((0.0, 9.0, 4.5, 1.0, 2.0, 3.0))
    assert RULES[rule](scene, (0, 1, 5)) == expected


def test_a_draw_never_repeats_a_photograph_and_draws_differ() -> None:
    scene = pool(tuple(map(float, range(8))))
    orders = []
    for rule in (RULES[f"random {draw}"] for draw in range(5)):
        chosen: tuple[int, ...] = (0, 3, 7)
        while len(chosen) < 8:
            chosen = (*chosen, rule(scene, chosen))
        assert sorted(chosen) == list(range(8))
        orders.append(chosen)
    assert len(set(orders)) > 1


def curves(suggested: float) -> Measured:
    shared = {name: [10.0, 11.0, 12.0, 13.0] for name in RULES}
    return Measured(
        "s", {"suggested": [10.0, suggested, 13.0, 14.0], **shared}, [9.0, 11.0, suggested, 11.0]
    )


def test_the_table_compares_with_the_mean_and_the_best_choice() -> None:
    measured = curves(13.0)
    assert measured.gap == pytest.approx(1.0)
    assert "| s | 10.00 | 13.00 / 13.00 / 14.00 |" in table([measured])
    assert "| ahead of random, dB | +2.00 (+2.00 to +2.00) | +1.00" in summary([measured])


def test_a_missing_training_leaves_a_gap() -> None:
    measured = curves(13.0)
    short = Measured("t", measured.curves | {"farthest": [10.0, 11.0]}, measured.fourth)
    assert "11.00 / - / -" in table([short])
    assert "+1.00), 1 scenes" in summary([measured, short])


def test_an_interval_is_narrower_with_more_scenes() -> None:
    few, many = (interval([0.0, 2.0] * count) for count in (2, 50))
    assert few.startswith("+1.00 (+0.00 to +2.00)")
    assert many.startswith("+1.00 (+0.8")


def test_every_training_of_the_page_is_recorded() -> None:
    trainings, suggestions = read_records()
    for name in SCENES:
        sets = [views for scene, views in trainings if scene == name]
        assert {len(views) for views in sets} == {3, 4, 5, 6}
        assert sum(len(views) == 4 for views in sets) >= 14
        assert {len(views) for scene, views in suggestions if scene == name} == {3, 4, 5}


def test_what_is_recorded_is_not_trained_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "records.jsonl"
    line = {"scene": "line", "views": [0, 1, 2], "psnr": 12.5, "cpu_seconds": 1.0, "hash": "a"}
    file.write_text(json.dumps(line) + "\n")
    monkeypatch.setattr(next_views, "FILE", file)
    monkeypatch.delattr(next_views, "train")
    assert RecordedSets().psnr(pool((0.0, 1.0, 2.0, 3.0)), (2, 0, 1)) == 12.5
