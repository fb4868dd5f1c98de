"""Capability `stereo_disparity`: disparity of a rectified stereo pair."""

from __future__ import annotations

import logging
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.component import SettingsType
from ..contract.maps import Disparity
from ..contract.prior import Prior
from ..errors import PluginError
from .checking import check_map

if TYPE_CHECKING:
    from torch import Tensor

_log = logging.getLogger("stereogs.priors")


class StereoPrior(Prior[SettingsType]):
    """A prior that estimates the disparity of a rectified stereo pair."""

    capability: ClassVar[str] = "stereo_disparity"
    _warned = False

    @property
    def max_disparity(self) -> float | None:
        """Largest disparity that the prior can return, in pixels; None for no limit."""
        return None

    @abstractmethod
    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the left image's disparity, `[H, W]` pixels; non-finite or <= 0 means unknown.

        Args:
            left, right: `[H, W, 3]` float32 in [0, 1], any size.
        """

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Return disparities on the left and on the right image's grid; override to share work.

        The mirrored right image is the left image of the mirrored pair: D_r = flip(F(flip(I_r),
        flip(I_l))). The StereoGS paper exchanges the two arguments, which yields no matches.
        """
        mirrored = self.estimate(right.flip(1).contiguous(), left.flip(1).contiguous())
        check_map("disparity", mirrored, right)
        return self.estimate(left, right), mirrored.flip(1)

    def disparity(self, left: Tensor, right: Tensor) -> Disparity:
        """Return the left image's disparity.

        Raises:
            PluginError: The images differ in size, or the estimate has a wrong shape.
        """
        import torch

        _check_pair(left, right)
        with self.context.at_work(), torch.no_grad():
            return self._checked(self.estimate(left, right), left)

    def both(self, left: Tensor, right: Tensor) -> tuple[Disparity, Disparity]:
        """Return the left and the right image's disparity, both positive, each on its own grid.

        Raises:
            PluginError: See `disparity`.
        """
        import torch

        _check_pair(left, right)
        with self.context.at_work(), torch.no_grad():
            of_left, of_right = self.estimate_both(left, right)
            return self._checked(of_left, left), self._checked(of_right, right)

    def _checked(self, answer: Any, image: Tensor) -> Disparity:
        import torch

        check_map("disparity", answer, image)
        values = answer.detach().float()
        valid = torch.isfinite(values) & (values > 0)
        if not self._warned and not valid.any():
            self._warned = True
            _log.warning("prior %r returned no known disparity", self.context.name)
        return Disparity(torch.where(valid, values, 0.0), valid)


def _check_pair(left: Tensor, right: Tensor) -> None:
    if left.ndim != 3 or left.shape[2] != 3 or left.shape != right.shape:
        raise PluginError(
            f"a stereo pair has the shapes {tuple(left.shape)} and {tuple(right.shape)}; "
            "both must be [H, W, 3]"
        )
