"""`benchmarks.priors_depth` on priors with known errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import priors_depth
from core_rasterizer import open_device
from tests.stereogs_plugins.initializers.depth_scenes import prior_of, true_depth


def test_known_errors_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.setattr(priors_depth, "ROOMS", (2,))
    monkeypatch.setattr(priors_depth, "PHOTOGRAPHS", ())
    priors = {
        "exact": prior_of(true_depth),
        "short": prior_of(lambda view: 0.98 * true_depth(view)),
    }
    monkeypatch.setattr(priors_depth, "_priors", lambda *_: priors)
    rows = priors_depth.measure(open_device(), Path("none"))
    assert [row.part for row in rows] == 2 * ["all", "slanted", "even"]
    for row in rows:
        assert row.kept > 0.3
        one, three = row.right
        assert (one > 0.95) == (row.prior == "exact")
        assert three > 0.9
    header, *lines = priors_depth.table(rows)
    assert header == ["scene", "of", "exact", "short"]
    assert [line[1] for line in lines] == ["all", "slanted", "even"]
    assert lines[0][2].startswith(f"{rows[0].kept:.0%}: ")
