"""Measures of confidence, on cases whose values are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.confidence import fitted
from benchmarks.confidence_measures import auroc, ause, rank_correlation, reliability


def test_ause_is_zero_for_the_errors_themselves_and_larger_for_their_reverse() -> None:
    errors = np.random.default_rng(1).random(5000)
    assert ause(errors, -errors) == pytest.approx(0, abs=1e-12)
    no_idea, reverse = ause(errors, np.zeros(5000)), ause(errors, errors)
    # Without knowledge the curve stays at 1; by the errors it falls linearly to 0: half of the square.
    assert no_idea == pytest.approx(0.5, abs=0.02)
    assert reverse > no_idea
    assert 0 < ause(errors, np.zeros(5000), squared=True) < no_idea


def test_auroc() -> None:
    errors = np.array([0.0, 0.05, 0.2, 0.3])
    assert auroc(errors, np.array([0.9, 0.8, 0.2, 0.1])) == 1
    assert auroc(errors, np.array([0.1, 0.2, 0.8, 0.9])) == 0
    assert auroc(errors, np.zeros(4)) == 0.5
    assert auroc(errors[:2], np.zeros(2)) is None


def test_rank_correlation_and_reliability() -> None:
    assert rank_correlation([1, 2, 3], [10, 20, 21]) == pytest.approx(1)
    rows = reliability(np.array([0.0, 0.2, 0.0]), np.array([0.05, 0.05, 1.0]))
    assert rows[0] == (2, 0.05, 0.5)
    assert rows[9] == (1, 1.0, 1.0)


def test_weights_are_found_again() -> None:
    draw = np.random.default_rng(0)
    evidence = np.column_stack([np.ones(20_000), draw.normal(size=(20_000, 2))])
    means = np.exp(evidence @ [-2.0, 0.5, -0.3])
    found = fitted(evidence, draw.exponential(means))
    assert found == pytest.approx([-2.0, 0.5, -0.3], abs=0.05)
