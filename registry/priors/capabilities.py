"""One base class per capability of priors, with checks and caching of estimates."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..contract.scene import DepthMap, Disparity, Flow, Matches, TrainingView
from ..errors import PluginError
from ..toolkit.drawing.pictures import nearness_picture
from .prior_cache import cached, stem

if TYPE_CHECKING:
    from torch import Tensor

_log = logging.getLogger("stereogs.priors")


class MultiViewDepthPrior(Prior[SettingsType]):
    """A prior that estimates the depth of several views jointly, from their images and cameras."""

    capability: ClassVar[str] = "multi_view_depth"

    @abstractmethod
    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map per view, in order; unknown depths may be 0 or non-finite.

        Args:
            views: Two or more views of any sizes.
            bounds: (near, far) z-depth of the scene's content, world units.
        """

    def depths(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> list[DepthMap]:
        """Return one depth map per view; cached on disk.

        Raises:
            PluginError: There are fewer than two views, or the estimate has a wrong length or shape.
        """
        if len(views) < 2:
            raise PluginError(
                f"multi-view depth needs two views, got {len(views)}",
                fix="use more training views, or an initializer without a prior",
            )

        found = cached(
            self,
            views,
            [bounds],
            lambda: self._checked(views, bounds),
            lambda found: {
                f"{stem(view)}_depth": nearness_picture(
                    1 / found[f"{i}/depth"], found[f"{i}/valid"]
                )
                for i, view in enumerate(views)
            },
        )
        names = ("depth", "valid", "confidence")
        return [DepthMap(*(found[f"{i}/{name}"] for name in names)) for i in range(len(views))]

    def _checked(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> dict[str, Tensor]:
        with self.context.at_work():
            answers = self.estimate(views, bounds)
            if not isinstance(answers, list | tuple):
                got = type(answers).__name__
                raise PluginError(f"the answer is a {got}, expected a list of depth maps")
            if len(answers) != len(views):
                raise PluginError(f"{len(answers)} depth maps came for {len(views)} views")
            maps = [_checked_depth(a, view.image) for a, view in zip(answers, views, strict=True)]
            return {
                f"{i}/{name}": x for i, found in enumerate(maps) for name, x in vars(found).items()
            }


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
        check_shape("disparity", mirrored, tuple(right.shape[:2]))
        return self.estimate(left, right), mirrored.flip(1)

    def disparity(self, left: Tensor, right: Tensor) -> Disparity:
        """Return the left image's disparity.

        Raises:
            PluginError: The images differ in size, or the estimate has a wrong shape.
        """
        _check_pair(left, right)
        with at_work(self):
            return self._checked(self.estimate(left, right), left)

    def both(self, left: Tensor, right: Tensor) -> tuple[Disparity, Disparity]:
        """Like `disparity`, for the left and the right image, both positive, each on its own grid."""
        _check_pair(left, right)
        with at_work(self):
            of_left, of_right = self.estimate_both(left, right)
            return self._checked(of_left, left), self._checked(of_right, right)

    def _checked(self, answer: Any, image: Tensor) -> Disparity:
        check_shape("disparity", answer, tuple(image.shape[:2]))
        values = answer.detach().float()
        valid = values.isfinite() & (values > 0)
        if not self._warned and not valid.any():
            self._warned = True
            _log.warning("prior %r returned no known disparity", self.context.name)
        return Disparity(values.where(valid, 0.0), valid)


class OpticalFlowPrior(Prior[SettingsType]):
    """A prior that estimates the displacement of each pixel between two images."""

    capability: ClassVar[str] = "optical_flow"

    @abstractmethod
    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        """Return `[H, W, 2]`: pixel (u, v) of the first image is at (u, v) + flow[v, u] in the second.

        Non-finite values mean unknown.

        Args:
            first, second: `[H, W, 3]` float32 in [0, 1]; their sizes may differ.
        """

    def flow(self, first: Tensor, second: Tensor) -> Flow:
        """Return the flow between two images; not cached.

        Raises:
            PluginError: The estimate has a wrong shape.
        """
        with at_work(self):
            answer = self.estimate(first, second)
            check_shape("flow", answer, (*first.shape[:2], 2))
        vectors = answer.detach().float()
        valid = vectors.isfinite().all(dim=2)
        return Flow(vectors.where(valid[..., None], 0.0), valid)

    def flow_between(self, first: TrainingView, second: TrainingView) -> Flow:
        """`flow` between two photographs; cached on disk."""
        picture = f"{stem(first)}_{stem(second)}_length"
        found = cached(
            self,
            [first, second],
            [],
            lambda: dict(vars(self.flow(first.image, second.image))),
            lambda found: {picture: nearness_picture(found["vectors"].norm(dim=2), found["valid"])},
        )
        return Flow(**found)


class MatchingPrior(Prior[SettingsType]):
    """A prior that matches points of two images."""

    capability: ClassVar[str] = "matches"

    @abstractmethod
    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """Return matches in any order; those outside the images will be dropped.

        Args:
            first, second: `[H, W, 3]` float32 in [0, 1]; their sizes may differ.
        """

    def matches(self, first: Tensor, second: Tensor) -> Matches:
        """Return the matches of two images; not cached.

        Raises:
            PluginError: The estimate has wrong types, shapes or non-finite values.
        """
        with at_work(self):
            answer = self.estimate(first, second)
            _check_matches(answer)
        inside = _inside(answer.first, first) & _inside(answer.second, second)
        points = answer.first[inside].float(), answer.second[inside].float()
        return Matches(*points, answer.scores[inside].float().clamp(0, 1))

    def matches_between(self, first: TrainingView, second: TrainingView) -> Matches:
        """`matches` of two photographs; cached on disk."""
        found = cached(
            self,
            [first, second],
            [],
            lambda: dict(vars(self.matches(first.image, second.image))),
            lambda found: {},
        )
        return Matches(**found)


@contextmanager
def at_work(prior: Prior[Any], gradients: bool = False) -> Iterator[None]:
    """`Context.at_work` without gradients, or with gradients if the caller enables them."""
    import torch

    with prior.context.at_work(), torch.set_grad_enabled(gradients and torch.is_grad_enabled()):
        yield


def check_shape(what: str, answer: Any, shape: tuple[int, ...]) -> None:
    from torch import Tensor

    got = tuple(answer.shape) if isinstance(answer, Tensor) else type(answer).__name__
    if got != shape:
        raise PluginError(f"the {what} is {got}, expected a tensor of shape {shape}")


def check_finite(what: str, answer: Tensor) -> None:
    if not answer.isfinite().all():
        raise PluginError(f"the {what} has values that are not finite")


def _check_pair(left: Tensor, right: Tensor) -> None:
    if left.ndim != 3 or left.shape[2] != 3 or left.shape != right.shape:
        shapes = f"{tuple(left.shape)} and {tuple(right.shape)}"
        raise PluginError(f"a stereo pair has the shapes {shapes}; both must be [H, W, 3]")


def _check_matches(answer: Any) -> None:
    if not isinstance(answer, Matches):
        raise PluginError(f"the answer is a {type(answer).__name__}, expected Matches")
    count = next(iter(getattr(answer.scores, "shape", ())), 0)
    for name, shape in (("first", (count, 2)), ("second", (count, 2)), ("scores", (count,))):
        check_shape(f"matches' {name}", getattr(answer, name), shape)
        check_finite(f"matches' {name}", getattr(answer, name))


def _checked_depth(answer: Any, image: Tensor) -> DepthMap:
    """The map with zeros where depth or confidence is unknown."""
    for name in ("depth", "valid", "confidence"):
        check_shape(name, getattr(answer, name, None), tuple(image.shape[:2]))
    depth, confidence = answer.depth.detach().float(), answer.confidence.detach().float()
    valid = answer.valid & depth.isfinite() & (depth > 0) & confidence.isfinite()
    return DepthMap(depth.where(valid, 0.0), valid, confidence.clamp(0, 1).where(valid, 0.0))


def _inside(points: Tensor, image: Tensor) -> Tensor:
    height, width = image.shape[:2]
    u, v = points.unbind(dim=1)
    return (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
