"""Prior models by capability: what each is asked, and the one place where its answers are checked.

A prior plugin derives from one of these classes and implements `estimate`. Consumers call the public
method beside it, which checks sizes and values, so that no NaN ever reaches a loss or a point cloud,
and answers from the disk cache where asking again could only repeat the answer.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..cache import content_key
from ..contract.component import SettingsType
from ..contract.maps import DepthMap, Disparity
from ..contract.prior import Prior
from ..contract.scene import TrainingView
from ..drawing.pictures import nearness_picture
from ..errors import PluginError
from .prior_cache import PriorCache, code_digest


class StereoPrior(Prior[SettingsType]):
    """Disparity of a rectified stereo pair."""

    capability: ClassVar[str] = "stereo_disparity"

    @property
    def max_disparity(self) -> float | None:
        """The largest disparity that the model can answer, in pixels; None if it has no limit."""
        return None

    @abstractmethod
    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the left image's disparity, `[H, W]` pixels; not finite or <= 0 means unknown.

        Args:
            left, right: `[H, W, 3]` float32 in [0, 1], any size.
        """

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Disparities on the left and on the right image's grid; override to share work.

        A mirrored right image is the left image of the mirrored pair: D_r = flip(F(flip(I_r),
        flip(I_l))). StereoGS prints the two the other way round, which finds no match.
        """
        mirrored = self.estimate(right.flip(1).contiguous(), left.flip(1).contiguous())
        return self.estimate(left, right), mirrored.flip(1)

    def disparity(self, left: Tensor, right: Tensor) -> Disparity:
        """The left image's disparity.

        Raises:
            PluginError: the images differ in size, or the answer has the wrong shape.
        """
        _check_pair(left, right)
        with torch.no_grad():
            return _disparity(self.estimate(left, right), left)

    def both(self, left: Tensor, right: Tensor) -> tuple[Disparity, Disparity]:
        """The left and the right image's disparity, both positive, each on its own grid.

        Raises:
            PluginError: see `disparity`.
        """
        _check_pair(left, right)
        with torch.no_grad():
            of_left, of_right = self.estimate_both(left, right)
        return _disparity(of_left, left), _disparity(of_right, right)


class MultiViewDepthPrior(Prior[SettingsType]):
    """Depth of every view of a set, from all of them and their cameras."""

    capability: ClassVar[str] = "multi_view_depth"

    @abstractmethod
    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view, in order; unknown depths may be 0 or not finite.

        Args:
            views: two or more, of any sizes.
            bounds: (near, far) z-depth of the scene's content, world units.
        """

    def fingerprint(self) -> str:
        """What answers depend on beside settings and code: a model file's hash, a device."""
        return ""

    def depths(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> list[DepthMap]:
        """One depth map for each view, from the disk cache if the same question was asked before.

        Raises:
            PluginError: fewer than two views, or an answer of the wrong number or shape.
        """
        if len(views) < 2:
            raise PluginError(
                f"multi-view depth needs two views, there is {len(views)}",
                fix="use more training views, or an initializer without a prior",
            )
        cache = PriorCache(self.context.name)
        key = content_key(
            code_digest(type(self)),
            self.settings.model_dump_json(),
            self.fingerprint(),
            bounds,
            *(part for view in views for part in _content(view)),
        )
        found = cache.load(key)
        if found is None:
            with torch.no_grad():
                answers = self.estimate(views, bounds)
            if len(answers) != len(views):
                raise PluginError(f"{len(answers)} depth maps came for {len(views)} views")
            maps = [_depth_map(a, v) for a, v in zip(answers, views, strict=True)]
            names = [view.name.partition(".")[0] for view in views]
            pictures = {
                f"{name}_depth": nearness_picture(1 / answer.depth, answer.valid)
                for name, answer in zip(names, maps, strict=True)
            }
            cache.save(key, _pack(maps), pictures, {"views": names, "bounds": bounds})
            return maps
        return [_unpack(found, index) for index in range(len(views))]


class MonocularDepthPrior(Prior[SettingsType]):
    """Relative inverse depth of a single image."""

    capability: ClassVar[str] = "monocular_depth"

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor:
        """Return `[H, W]` relative inverse depth, larger = nearer, of unknown scale and shift.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def fingerprint(self) -> str:
        """What answers depend on beside settings and code: a model file's hash, a device."""
        return ""

    def inverse_depth(self, image: Tensor) -> Tensor:
        """Relative inverse depth `[H, W]` float32, from the disk cache where possible.

        Raises:
            PluginError: the answer has the wrong shape or values that are not finite.
        """
        cache = PriorCache(self.context.name)
        key = content_key(
            code_digest(type(self)), self.settings.model_dump_json(), self.fingerprint(), image
        )
        found = cache.load(key)
        if found is not None:
            return found["inverse_depth"]
        with torch.no_grad():
            answer = self.estimate(image)
        _check_map("inverse depth", answer, image)
        if not torch.isfinite(answer).all():
            raise PluginError("the inverse depth has values that are not finite")
        answer = answer.float().contiguous()
        picture = nearness_picture(answer, torch.ones_like(answer, dtype=torch.bool))
        cache.save(key, {"inverse_depth": answer}, {"inverse_depth": picture}, {})
        return answer


def _check_pair(left: Tensor, right: Tensor) -> None:
    if left.ndim != 3 or left.shape[2] != 3 or left.shape != right.shape:
        raise PluginError(
            f"a stereo pair has the shapes {tuple(left.shape)} and {tuple(right.shape)}; "
            "both must be [H, W, 3]"
        )


def _check_map(what: str, answer: Any, image: Tensor) -> None:
    shape = tuple(image.shape[:2])
    if not isinstance(answer, Tensor) or tuple(answer.shape) != shape:
        got = tuple(answer.shape) if isinstance(answer, Tensor) else type(answer).__name__
        raise PluginError(f"the {what} is {got}, expected a tensor of shape {shape}")


def _disparity(answer: Any, image: Tensor) -> Disparity:
    _check_map("disparity", answer, image)
    values = answer.detach().float()
    valid = torch.isfinite(values) & (values > 0)
    return Disparity(torch.where(valid, values, 0.0), valid)


def _depth_map(answer: Any, view: TrainingView) -> DepthMap:
    for name in ("depth", "valid", "confidence"):
        _check_map(name, getattr(answer, name, None), view.image)
    depth, confidence = answer.depth.detach().float(), answer.confidence.detach().float()
    valid = answer.valid & torch.isfinite(depth) & (depth > 0) & torch.isfinite(confidence)
    return DepthMap(
        torch.where(valid, depth, 0.0), valid, torch.where(valid, confidence.clamp(0, 1), 0.0)
    )


def _content(view: TrainingView) -> tuple[Tensor | None, ...]:
    """Everything of a view that an estimate may depend on."""
    return view.image, view.mask, view.camera.world_to_camera, view.camera.intrinsics


def _pack(maps: Sequence[DepthMap]) -> dict[str, Tensor]:
    packed = {}
    for index, answer in enumerate(maps):
        packed[f"{index}/depth"] = answer.depth.contiguous()
        packed[f"{index}/valid"] = answer.valid.contiguous()
        packed[f"{index}/confidence"] = answer.confidence.contiguous()
    return packed


def _unpack(found: Mapping[str, Tensor], index: int) -> DepthMap:
    return DepthMap(*(found[f"{index}/{name}"] for name in ("depth", "valid", "confidence")))
