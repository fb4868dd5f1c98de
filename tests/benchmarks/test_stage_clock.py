from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from benchmarks import stage_clock
from benchmarks.stage_clock import INTERPRETER, REST, StageClock


def test_a_stage_within_another_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    clocked = SimpleNamespace(monotonic=lambda: now[0], process_time=lambda: 2 * now[0])
    monkeypatch.setattr(stage_clock, "time", clocked)
    clock = StageClock(born=9.0)
    worker = SimpleNamespace()
    device, settled = object(), []

    def inner(device: object) -> int:
        now[0] += 3
        return 7

    def outer() -> int:
        now[0] += 1
        answer: int = worker.inner(device)
        now[0] += 2
        return answer

    def failing() -> None:
        now[0] += 4
        raise ValueError("it failed")

    def settle(device: object) -> None:
        settled.append(device)
        now[0] += 1

    worker.inner, worker.outer, worker.failing = inner, outer, failing
    clock.wrap(worker, "inner", "inside", settle=settle)
    clock.wrap(worker, "outer", "outside")
    clock.wrap(worker, "failing", "inside")
    assert worker.outer() == 7
    with pytest.raises(ValueError, match="it failed"):
        worker.failing()
    now[0] += 5
    taken = clock.finish()
    assert taken == {INTERPRETER: [1, 20], REST: [5, 10], "outside": [3, 6], "inside": [8, 16]}
    assert settled == [device]


def test_every_stage_of_a_run_can_be_wrapped() -> None:
    """If a method is renamed, the table must not lose its stage silently."""
    wrapped = []

    class Listing(StageClock):
        def wrap(self, owner: object, attribute: str, name: str, settle: object = None) -> None:
            assert callable(getattr(owner, attribute)), (owner, attribute)
            wrapped.append(name)

    stage_clock.wrap_stages(Listing(time.monotonic()))
    assert {"photographs", "depth prior", "points", "evaluation"} <= {*wrapped}
