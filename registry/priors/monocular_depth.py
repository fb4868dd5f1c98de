"""Depth of single images: the capability of monocular networks."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..contract.scene import PointCloud, TrainingView
from ..errors import PluginError
from ..toolkit.drawing.pictures import nearness_picture
from .capabilities import at_work, check_finite, check_shape
from .prior_cache import cached

if TYPE_CHECKING:
    from torch import Tensor

Ambiguity = Literal["affine", "scale", "metric"]
_FORM = "form"
"""Name of a cached tensor: whether values are inverse depth, and the index of their ambiguity."""


@dataclass(frozen=True, eq=False)
class MonocularDepth:
    """Depth of one image.

    Args:
        values: `[H, W]`, z-depth or its inverse. Checked answers have the farthest valid value where `valid`
            is False.
        inverse: whether larger is nearer.
        ambiguity: what is unknown about the values: "affine", a factor > 0 and an offset; "scale", the
            factor; "metric", nothing: they are metres or their inverse.
        valid: `[H, W]` bool, False for example in the sky; None where all pixels are valid.
        confidence: `[H, W]` in [0, 1], or None.
        intrinsics: `[3, 3]` in pixels of the image, or None.
        normals: `[H, W, 3]` unit vectors towards the camera, in its axes (x right, y down, z forward), or
            None.
    """

    values: Tensor
    inverse: bool = True
    ambiguity: Ambiguity = "affine"
    valid: Tensor | None = None
    confidence: Tensor | None = None
    intrinsics: Tensor | None = None
    normals: Tensor | None = None

    @property
    def farness(self) -> Tensor:
        """`[H, W]`, depth up to a factor and an offset, or minus the inverse depth if it has an offset."""
        if not self.inverse:
            return self.values
        return -self.values if self.ambiguity == "affine" else 1 / self.values

    @property
    def nearness(self) -> Tensor:
        """`[H, W]` relative inverse depth, larger = nearer, with unknown scale and shift.

        Raises:
            PluginError: it is depth with an unknown offset, which cannot be inverted.
        """
        if self.inverse:
            return self.values
        if self.ambiguity == "affine":
            raise PluginError(
                "the prior estimates depth with an unknown offset, which cannot be inverted",
                fix="use `prior.depth_of(view).farness`",
            )
        return 1 / self.values


class MonocularDepthPrior(Prior[SettingsType]):
    """A prior that estimates the depth of a single image."""

    capability: ClassVar[str] = "monocular_depth"
    differentiable: ClassVar[bool] = False
    """True if `estimate` supports autograd; `depth` then propagates gradients to the image."""

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor | MonocularDepth:
        """Return depth, or `[H, W]` relative inverse depth, larger = nearer, with unknown scale and shift.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def estimate_view(
        self, view: TrainingView, points: PointCloud | None
    ) -> Tensor | MonocularDepth:
        """Like `estimate`, for a photograph; override it to use its camera, or to align depth to points.

        Args:
            points: of the scene, in world units, or None if it has none.
        """
        return self.estimate(view.image)

    def depth(self, image: Tensor) -> MonocularDepth:
        """Return the depth of any image, for example a render; not cached.

        Raises:
            PluginError: The estimate has a wrong type, shape or range, or values that are not finite.
        """
        with at_work(self, gradients=self.differentiable):
            return _checked(self.estimate(image), image)

    def depth_of(self, view: TrainingView, points: PointCloud | None = None) -> MonocularDepth:
        """Return the depth of a photograph; cached on disk.

        Args:
            points: of the scene (`TrainingScene.points`), for priors that align their estimate.
        """
        aligns = type(self).estimate_view is not MonocularDepthPrior.estimate_view
        known = [points.positions] if aligns and points is not None else []
        found = cached(self, [view], known, lambda: self._tensors(view, points), _pictures)
        inverse, ambiguity = found[_FORM].tolist()
        maps: dict[str, Any] = {name: x for name, x in found.items() if name != _FORM}
        return MonocularDepth(
            **maps, inverse=bool(inverse), ambiguity=get_args(Ambiguity)[ambiguity]
        )

    def inverse_depth(self, image: Tensor) -> Tensor:
        """Return `MonocularDepth.nearness` of any image; not cached."""
        return self.depth(image).nearness

    def inverse_depth_of(self, view: TrainingView) -> Tensor:
        """Return `MonocularDepth.nearness` of a photograph; cached on disk."""
        return self.depth_of(view).nearness

    def _tensors(self, view: TrainingView, points: PointCloud | None) -> dict[str, Tensor]:
        import torch

        with at_work(self):
            answer = _checked(self.estimate_view(view, points), view.image)
        form = [int(answer.inverse), get_args(Ambiguity).index(answer.ambiguity)]
        given = {name: x for name, x in vars(answer).items() if isinstance(x, torch.Tensor)}
        return {**given, _FORM: torch.tensor(form)}


def _pictures(found: dict[str, Tensor]) -> dict[str, Tensor]:
    values = found["values"]
    inverse, _ = found[_FORM].tolist()
    nearness = values if inverse else -values
    return {"inverse_depth": nearness_picture(nearness, found.get("valid", values.isfinite()))}


def _checked(answer: Any, image: Tensor) -> MonocularDepth:
    """The answer with float32 maps that are finite everywhere, and `valid` only if a pixel is not."""
    size = tuple(image.shape[:2])
    if not isinstance(answer, MonocularDepth):
        check_shape("inverse depth", answer, size)
        check_finite("inverse depth", answer)
        return MonocularDepth(answer.float().contiguous())
    if answer.ambiguity not in get_args(Ambiguity):
        raise PluginError(
            f"the ambiguity is {answer.ambiguity!r}",
            fix=f"use one of {', '.join(get_args(Ambiguity))}",
        )
    shapes = {"valid": size, "confidence": size, "intrinsics": (3, 3), "normals": (*size, 3)}
    check_shape("depth", answer.values, size)
    for name, shape in shapes.items():
        if (value := getattr(answer, name)) is not None:
            check_shape(name, value, shape)
    valid = answer.values.isfinite()
    if answer.valid is not None:
        valid = valid & answer.valid.bool()
    if answer.ambiguity != "affine":
        valid = valid & (answer.values > 0)
    if answer.intrinsics is not None:
        check_finite("intrinsics", answer.intrinsics)
    return replace(
        answer,
        values=_filled(answer.values.float(), valid, answer.inverse),
        valid=None if valid.all() else valid,
        confidence=_confidence(answer.confidence, valid),
        normals=None
        if answer.normals is None
        else unit_normals(answer.normals).where(valid[..., None], 0.0),
    )


def _filled(values: Tensor, valid: Tensor, inverse: bool) -> Tensor:
    """The values, and the farthest valid one elsewhere."""
    known = values.detach()[valid]
    if not len(known):
        return values.new_ones(values.shape)
    return values.where(valid, known.min() if inverse else known.max()).contiguous()


def _confidence(confidence: Tensor | None, valid: Tensor) -> Tensor | None:
    if confidence is None:
        return None
    low, high = confidence[valid].aminmax() if valid.any() else (0, 1)
    if not (low >= 0 and high <= 1):
        raise PluginError(
            f"the confidence is {float(low):g} to {float(high):g}, not 0 to 1",
            fix="return probabilities, for example the sigmoid of logits",
        )
    return confidence.detach().float().where(valid, 0.0)


def unit_normals(normals: Tensor) -> Tensor:
    """Return normals `[H, W, 3]` of length 1, and 0 where they are not finite or zero."""
    given = normals.detach().float()
    length = given.norm(dim=2)
    known = length.isfinite() & (length > 0)
    unit: Tensor = (given / length[..., None]).where(known[..., None], 0.0)
    return unit
