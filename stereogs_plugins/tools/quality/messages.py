"""What was chosen and why, for people."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from registry.pipeline import Pipeline

from .cost import Cost

if TYPE_CHECKING:
    from registry.runs import InitialState

    from .rehearsal import Measured

Say = Callable[[str], None]
"""Takes a line."""


def tell_choice(chosen: Pipeline, because: str, initial: InitialState, say: Say) -> None:
    """Say which pipeline, for what, and why, in lines of 80 characters at most."""
    for line in _reasons(chosen, because, initial):
        say(line)


def _reasons(chosen: Pipeline, because: str, initial: InitialState) -> Iterator[str]:
    training, camera = chosen.training, initial.scene.train[0].camera
    kind = initial.points.facts.get("scene_kind")
    yield f"trained: {chosen.name}, {training.iterations:,} iterations" + (
        f", at most {training.max_gaussians:,} Gaussians" if training.max_gaussians else ""
    )
    views = f"{len(initial.scene.train)} training views of {camera.width}x{camera.height} pixels"
    yield f"  for     {views}" + (f", {kind}" if kind else "")
    if because:
        yield f"  because {because}"


def tell_cost(cost: Cost, measured: Measured, count: int, seconds: float, say: Say) -> None:
    """Say what was measured and what is expected of so many iterations."""
    say(
        f"  measured {1000 * measured.iteration:.1f} ms an iteration with "
        f"{measured.gaussians:,} Gaussians"
    )
    say(
        f"  expected {cost.spent:.1f} s so far + {count * cost.iteration:.1f} s training + "
        f"{cost.after:.1f} s afterwards = {cost.seconds(count):.1f} s"
    )
    if cost.seconds(count) < 0.9 * seconds:
        say(f"  which is less than {seconds:g} s: more iterations are not known to help")
