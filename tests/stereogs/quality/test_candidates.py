"""The pipelines that a quality chooses from."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereogs.quality.table import BEST, LONG, MANY, QUALITIES, QUICK, SHORT, by_quality
from tests.host import SELECTION, Plugins, load_pipeline


def test_the_candidate_pipelines_have_the_same_initial_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The choice is made when the first points are there, which must be those of each."""
    monkeypatch.delenv(SELECTION)
    first, *others = (
        load_pipeline(Path(name), Plugins(), overrides=["scene=procedural"])
        for name in (SHORT, QUICK, LONG, BEST, MANY)
    )
    for other in others:
        for section in ("priors", "initializer"):
            assert first.items[section] == other.items[section]
        assert first.training.seed == other.training.seed
    assert {by_quality(quality).name for quality in QUALITIES} == {QUICK, SHORT, BEST}
