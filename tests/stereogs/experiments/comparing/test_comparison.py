"""Means over repetitions and scenes, and which runs are of one method."""

from __future__ import annotations

import pytest

from stereogs.experiments.comparing.comparison import method_means
from stereogs.experiments.comparing.labels import labels
from tests.stereogs.experiments.comparing.conftest import Make, runs


def test_means_are_over_repetitions_then_scenes(make: Make) -> None:
    flower = {"scene/name": "flower", "test/psnr": 26.0, "gaussians": 4000}
    again = {"test/psnr": 21.0, "gaussians": 3000}
    (mean,) = method_means(
        runs(
            make("a"),
            make("b", again, {"training/seed": 1, "metrics": []}),
            make("c", flower, {"scene/path": "flower"}),
        )
    )
    assert (mean.method, mean.scenes) == ("plain", ("fern", "flower"))
    assert mean.numbers["psnr"] == pytest.approx((20.5 + 26) / 2)
    assert mean.numbers["gaussians"] == pytest.approx((2000 + 4000) / 2)
    assert mean.numbers["lpips"] is None


def test_a_mean_needs_the_score_in_every_scene(make: Make) -> None:
    flower = {"scene/name": "flower", "test/lpips": 0.2}
    (mean,) = method_means(runs(make("a"), make("b", flower)))
    assert mean.numbers["lpips"] is None


def test_different_pipelines_are_two_methods(make: Make) -> None:
    means = method_means(runs(make("a"), make("b", None, {"training/iterations": 2000})))
    assert [mean.method for mean in means] == ["plain (a)", "plain (b)"]


def test_observers_do_not_make_another_method(make: Make) -> None:
    watched = {"observers": [{"use": "diary", "every": 5}]}
    found = runs(make("a"), make("b", {"scene/name": "flower"}, watched))
    assert [mean.method for mean in method_means(found)] == ["plain"]
    assert labels(found) == ["plain", "plain"]
