"""Which picture to take next, so that a trained scene gains most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from registry.calls.process_state import one_torch_thread

if TYPE_CHECKING:
    from core_rasterizer import Camera
    from registry.runs.run import Run

    from .where_to_stand import Photographs


@dataclass(frozen=True, eq=False)
class NextView:
    """A suggested picture.

    Args:
        index: of the candidate.
        camera: pose and lens.
        gain: share of what is unknown in the candidates' views that it would confirm, in [0, 1], once the
            suggestions before it are taken.
        overlap: share of the picture that photographs show from a similar direction, in [0, 1]; below 0.3 it
            may not connect to them.
        words: where to stand and where to aim.
        reach: distance to what the camera looks at, world units.
    """

    index: int
    camera: Camera
    gain: float
    overlap: float
    words: str
    reach: float


@one_torch_thread()
def next_views(
    run: Run, candidates: Sequence[Camera] | None = None, *, count: int = 3
) -> list[NextView]:
    """Return the pictures from which a run's scene would gain most, best first.

    Each is chosen as if the ones before it were taken: neighbours of a suggestion are not suggested again.

    Args:
        candidates: cameras to choose from, in the world of the run's scene; None: around the photographs.
        count: how many; fewer are returned if there are fewer candidates.

    Raises:
        RunError: there are no candidates.
    """
    return suggestions(run, photographs_of(run), candidates, count)


def suggestions(
    run: Run, photographs: Photographs, candidates: Sequence[Camera] | None, count: int
) -> list[NextView]:
    """Return what `next_views` does, for the run's photographs.

    Raises:
        RunError: there are no candidates.
    """
    from registry import RunError

    from .candidates import around, free_view, reaches
    from .gain import ExpectedGain, small

    if candidates is None:
        candidates = around(photographs)
        seen = [(c, run.rendering(small(c))) for c in candidates]
        free = [c for c, rendering in seen if free_view(rendering, median(photographs.reach))]
        candidates = free or candidates
    if not candidates:
        raise RunError(
            "there is no camera to choose from",
            where=run.scene.name,
            fix="give candidates: poses, or pictures that the run did not train on",
        )
    gain = ExpectedGain(run.rendering, photographs.cameras, candidates)
    unknown = max(gain.unknown, 1e-12)
    left = list(range(len(candidates)))
    found: list[NextView] = []
    while left and len(found) < count:
        gains = gain.gains()
        best = max(left, key=lambda k: (float(gains[k]), -k))
        left.remove(best)
        camera = candidates[best]
        (reach,) = reaches(run.rendering, [camera])
        words = photographs.words(camera, reach)
        numbers = float(gains[best]) / unknown, float(gain.overlap[best])
        found.append(NextView(best, camera, *numbers, words, reach))
        gain.take(best)
    return found


def photographs_of(run: Run) -> Photographs:
    """Return the photographs that a run trained on, with their distances to what they show."""
    from .candidates import reaches
    from .where_to_stand import Photographs

    cameras = tuple(view.camera for view in run.scene.train)
    distances = reaches(run.rendering, cameras)
    return Photographs(tuple(view.name for view in run.scene.train), cameras, tuple(distances))
