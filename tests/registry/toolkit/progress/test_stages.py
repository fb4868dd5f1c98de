from __future__ import annotations

import io
import random
from typing import Any

import pytest
from rich.console import Console

from registry.toolkit.progress import stages as module
from registry.toolkit.progress.display import showing
from registry.toolkit.progress.parallel import in_parallel
from registry.toolkit.progress.stages import Stage, Stages, tracked
from tests.host import TrainingProgress


class Clock:
    """A clock that tests turn forward."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of `STAGES`."""
    made = Clock()
    monkeypatch.setattr(module.STAGES, "clock", made)
    monkeypatch.setattr(module.STAGES, "current", None)
    return made


def after(seconds_of_steps: list[float], total: int, first: int = 0) -> float | None:
    """The time left after steps of these durations."""
    stage, now = Stage("training", first, total, 0.0), 0.0
    for done, seconds in enumerate(seconds_of_steps, first + 1):
        now += seconds
        stage.reached(done, now)
    return stage.seconds_left(now)


def test_no_time_left_is_given_before_it_is_known() -> None:
    assert after([], 100) is None
    assert after([0.2] * 10, 100) is None, "two seconds"
    assert after([20.0], 12) is None, "one step, which may have compiled kernels"
    assert after([20.0, 20.0], 12) == pytest.approx(200)


def test_the_time_left_of_equal_steps() -> None:
    assert after([0.1] * 100, 600) == pytest.approx(50, rel=0.1)
    assert after([0.1] * 100, 600, first=300) == pytest.approx(20, rel=0.1), "a resumed run"
    assert after([0.001] * 6000, 12_000) == pytest.approx(6, rel=0.1)
    assert after([0.01] * 600_000, 1_200_000) == pytest.approx(6000, rel=0.1), "samples are thinned"


def test_slow_first_steps_do_not_count() -> None:
    assert after([60.0] + [0.1] * 100, 600) == pytest.approx(50, rel=0.1)
    cold = [8.0, 3.0, 0.9] + [0.15] * 12  # kernels were compiled
    assert all(after(cold[:steps], 600) is None for steps in range(10))
    assert after(cold, 600) == pytest.approx(585 * 0.15, rel=0.1)


def test_steps_that_become_slower_are_expected_to_go_on_so() -> None:
    steps = [0.05 + 0.0002 * k for k in range(600)]
    for done in (100, 150, 300, 450):
        left = after(steps[:done], 600)
        assert left is not None
        assert 0.8 < left / sum(steps[done:]) < 1.25


def test_time_passes_between_two_steps() -> None:
    stage = Stage("depth", 0, 4, 0.0)
    for done in (1, 2):
        stage.reached(done, 10.0 * done)
    assert stage.seconds_left(25.0) == pytest.approx(15)
    assert stage.seconds_left(99.0) == 0


def test_the_time_left_of_a_training_on_a_busy_machine(clock: Clock) -> None:
    """Ten seconds after the start, in 200 trainings; without `growth` 11 estimates are too short."""
    ratios = [estimate_over_truth(seed, clock) for seed in range(200)]
    assert min(ratios) > 0.5
    assert max(ratios) < 2


def estimate_over_truth(seed: int, clock: Clock) -> float:
    """Simulate a training whose share of a processor changes every eight seconds or so."""
    generator = random.Random(seed)
    now, changes, share, stage = clock.now, 0.0, 1.0, TrainingProgress(0, 600).stage
    estimate = at = None
    for done in range(1, 601):
        work = 0.03 * (1 + done / 600)  # becomes twice as slow
        while work > 0:
            if now >= changes:
                share, changes = (
                    1 / generator.choice([6, 9, 12]),
                    now + generator.expovariate(1 / 8),
                )
            worked = min(work, (changes - now) * share)
            work, now = work - worked, now + worked / share
        stage.reached(done, now)
        if now >= 10 and estimate is None:
            estimate, at = stage.seconds_left(now), now
    assert estimate is not None
    assert at is not None
    return estimate / (now - at)


def test_no_time_left_is_given_at_the_end() -> None:
    stage = Stage("training", 0, 20, 0.0)
    for done in range(1, 21):
        stage.reached(done, done * 0.4)
        assert "0:00 left" not in stage.text(done * 0.4, running=True)
    assert "left" not in stage.text(8.0, running=True)
    late = Stage("depth", 0, 4, 0.0)
    for done in (1, 2):
        late.reached(done, 10.0 * done)
    assert late.text(19.5, running=True).endswith("0:21 left")
    assert late.text(99.0, running=True) == "2/4", "the estimate was too short"


def test_what_begins_a_stage() -> None:
    stages = Stages(Clock())
    seen: list[Stage | None] = []

    def report(*what: object) -> bool:
        """Whether the report began a stage."""
        stages.report(*what)  # type: ignore[arg-type]
        seen.append(stages.current)
        return len(seen) < 2 or seen[-1] is not seen[-2]

    assert report("reading")
    assert not report("reading", 0, 12), "the number of steps became known"
    assert not report("reading", 3, 12)
    assert report("reading", 0, 12), "once more"
    assert report("matching", 0, 66)
    assert not report("matching", 5, 66)
    assert not report("matching", 4, 66), "threads finish in any order"
    assert stages.current is not None
    assert stages.current.done == 5


def test_components_do_not_leave_the_stage_of_the_training() -> None:
    clock = Clock()
    stages = Stages(clock)
    with stages.fixed(Stage("training", 0, 10, 0.0)):
        stages.report("training", 1, 10)
        clock.now = 7.0
        stages.report("depth", 3, 12)
        assert stages.current is not None
        assert (stages.current.name, stages.current.done) == ("training", 1)
    stages.report("scoring")
    assert stages.current.name == "scoring"


def test_lines_without_a_terminal(clock: Clock) -> None:
    file = io.StringIO()
    with showing(Console(file=file)):
        for pair in tracked(range(66), "matching"):
            clock.now += 1
            assert module.STAGES.current is not None
            assert module.STAGES.current.done == pair
        assert in_parallel(abs, [-1, 2, -3], stage="depth") == [1, 2, 3]
        assert (current := module.STAGES.current) is not None
        assert (current.name, current.done) == ("depth", 3)
    lines = file.getvalue().splitlines()
    assert lines[:2] == ["matching  0/66", "matching  10/66  0:56 left"]
    assert lines[-2:] == ["matching  60/66  0:06 left", "depth     0/3"]
    assert len(lines) == 1 + 6 + 1
    assert module.STAGES.current is None


def test_nothing_is_printed_on_a_quiet_console(clock: Clock) -> None:
    loud, quiet = io.StringIO(), io.StringIO()
    with showing(Console(file=loud)):
        with showing(Console(file=quiet, quiet=True, force_terminal=True)):
            module.progress("depth", 1, 3)
        module.progress("points")
    assert quiet.getvalue() == ""
    assert loud.getvalue() == "points\n"


@pytest.mark.parametrize("width", [20, 60, 100])
def test_the_bar_fits_into_the_terminal(width: int, clock: Clock) -> None:
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, color_system=None, width=width)
    with showing(console):
        stage = Stage("training", 0, 600, 0.0)
        stage.detail = lambda: "loss 0.0512  57,003 Gaussians  12.3 it/s"
        with module.STAGES.fixed(stage):
            for done in range(1, 31):
                clock.now += 1
                module.progress("training", done, 600)
            display: Any = module.STAGES.displays[0]
            bar = display.bar().plain
    assert len(bar) < width
    assert bar.startswith("training  ━─────────"[: width - 1])
    if width == 100:
        assert "30/600  9:30 left  loss 0.0512  57,003 Gaussians" in bar


def test_letters_stand_for_the_bar_where_the_terminal_has_no_lines(clock: Clock) -> None:
    file = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    with showing(Console(file=file, force_terminal=True, color_system=None)):
        module.progress("matching", 33, 66)
        display: Any = module.STAGES.displays[0]
        assert display.bar().plain == "matching  ##########---------- 33/66"


def test_parallel_work_keeps_its_order_and_its_errors() -> None:
    assert in_parallel(lambda value: value**2, range(50)) == [value**2 for value in range(50)]
    with pytest.raises(ZeroDivisionError):
        in_parallel(lambda value: 1 // value, [1, 0])
    assert in_parallel(lambda value: value, []) == []
