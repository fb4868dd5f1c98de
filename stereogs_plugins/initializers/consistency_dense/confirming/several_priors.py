"""One depth a pixel from several priors: the one that most other views confirm.

No prior is right everywhere: planes parallel to the image match fine texture and lose slanted surfaces and
wide baselines, planes of each pixel's own the other way round. What the views say of their answers tells
which is right where.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from registry.toolkit.photos import in_parallel

from .geometric_filter import Limits, supported

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from core_rasterizer import Camera

    from ..projection import DepthImage


@dataclass(frozen=True, eq=False)
class Choice:
    """One view's depths and whose they are.

    Args:
        answer: `[H, W]` the chosen prior's depth, 0 where it has none.
        confirmed: `[H, W]` as `consistent_depths` has it, 0 where no prior's depth is confirmed.
        prior: `[H, W]` the number of the chosen prior.
    """

    answer: DepthImage
    confirmed: DepthImage
    prior: NDArray[np.intp]


def most_confirmed(
    cameras: Sequence[Camera], answers: Sequence[Sequence[DepthImage]], limits: Limits
) -> list[Choice]:
    """For each view and pixel the depth that most other views confirm, the earlier prior's if as many do.

    A prior's depths are held against its own of the other views.

    Args:
        answers: of each prior, for each view `[H, W]` depths, 0 where unknown.
    """

    def choice(index: int) -> Choice:
        found = [supported(cameras, depths, index, limits) for depths in answers]
        prior = np.argmax([votes for _, votes in found], axis=0)  # the first of equals
        return Choice(
            answer=_chosen([depths[index] for depths in answers], prior),
            confirmed=_chosen([confirmed for confirmed, _ in found], prior),
            prior=prior,
        )

    return in_parallel(choice, range(len(cameras)))


def _chosen(depths: Sequence[DepthImage], prior: NDArray[np.intp]) -> DepthImage:
    chosen: DepthImage = np.take_along_axis(np.stack(depths), prior[None], axis=0)[0]
    return chosen
