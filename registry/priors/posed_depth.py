"""Cameras and depth of photographs without cameras: the capability of DA3, VGGT, MapAnything or Pi3."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..errors import PluginError
from ..toolkit.drawing.pictures import nearness_picture
from .capabilities import check_shape
from .prior_cache import cached

if TYPE_CHECKING:
    from torch import Tensor

_TOLERANCE = 1e-3
"""Largest excess of a confidence over the range 0 to 1, by rounding."""


@dataclass(frozen=True, eq=False)
class PosedDepth:
    """Camera and depth of one photograph; all photographs of an answer share the world and its unit.

    Args:
        world_to_camera: `[4, 4]` or `[3, 4]`, x right, y down, z forward.
        intrinsics: `[3, 3]` in pixels of the photograph; the centre of the first pixel is (0.5, 0.5).
        depth: `[H, W]` z-depth; <= 0 or not finite where unknown.
        confidence: `[H, W]`, see `PosedDepthPrior.confidences`.
    """

    world_to_camera: Tensor
    intrinsics: Tensor
    depth: Tensor
    confidence: Tensor

    @classmethod
    def from_points(
        cls,
        points: Tensor,
        world_to_camera: Tensor,
        confidence: Tensor,
        intrinsics: Tensor | None = None,
    ) -> PosedDepth:
        """Return the answer for a pointmap.

        Args:
            points: `[H, W, 3]` in the world; not finite where unknown.
            intrinsics: None fits the focal length to the points, with the principal point in the middle.
        """
        x, y, depth = (points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).unbind(dim=2)
        if intrinsics is None:
            intrinsics = _fitted(x / depth, y / depth, depth)
        return cls(world_to_camera, intrinsics, depth, confidence)


class PosedDepthPrior(Prior[SettingsType]):
    """A prior that estimates the cameras and the depth of photographs together.

    Its cameras are only a start: `photos` (`cameras: NAME`) refines them with its own matches, and leaves out
    what these contradict.
    """

    capability: ClassVar[str] = "posed_depth"
    confidences: ClassVar[Literal["probability", "logits"]] = "probability"
    """What `estimate` returns as confidence: probabilities in [0, 1], or their logits."""
    metric: ClassVar[bool] = False
    """Whether the unit of the answer's world is a metre; otherwise it is unknown, and of each call."""
    accepted_views: tuple[int, int | None] = (2, None)
    """Least and largest number of photographs of one call; None: no limit. Constructors may change it."""

    @abstractmethod
    def estimate(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> list[PosedDepth]:
        """Return camera and depth of each photograph, in order.

        Args:
            images: each `[H, W, 3]` float32 in [0, 1]; sizes may differ.
            intrinsics: each `[3, 3]` float64 in pixels, or None where unknown.
        """

    def refusal(self, count: int) -> str | None:
        """Return why a number of photographs is not accepted, or None."""
        least, most = self.accepted_views
        if least <= count <= (most or count):
            return None
        accepted = f"{least} to {most}" if most else f"{least} or more"
        return f"the prior {self.context.name!r} accepts {accepted} photographs, and got {count}"

    def posed_depths(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> list[PosedDepth]:
        """Return camera and depth of each photograph; cached on disk.

        Cameras are float64, `world_to_camera` `[4, 4]`; depth is float32, 0 where unknown; confidence is a
        probability, 0 where depth is unknown.

        Raises:
            PluginError: the number of photographs is not accepted; or the answer has a wrong length, shape,
                camera or confidence.
        """
        if problem := self.refusal(len(images)):
            raise PluginError(problem, fix="choose another prior, or other photographs")
        found = cached(
            self,
            [],
            [*images, *intrinsics],
            lambda: self._checked(images, intrinsics),
            lambda found: {
                f"{k}_depth": nearness_picture(1 / depth, depth > 0)
                for k in range(len(images))
                for depth in [found[f"{k}/depth"]]
            },
        )
        names = PosedDepth.__dataclass_fields__
        return [PosedDepth(*(found[f"{k}/{name}"] for name in names)) for k in range(len(images))]

    def _checked(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> dict[str, Tensor]:
        with self.context.at_work():
            answers = self.estimate(images, intrinsics)
            if not isinstance(answers, list | tuple) or len(answers) != len(images):
                got = len(answers) if isinstance(answers, list | tuple) else type(answers).__name__
                raise PluginError(
                    f"{got} came for {len(images)} photographs, expected a list of `PosedDepth`"
                )
            checked = [
                self._checked_view(k, answer, image)
                for k, (answer, image) in enumerate(zip(answers, images, strict=True))
            ]
        return {
            f"{k}/{name}": x for k, view in enumerate(checked) for name, x in vars(view).items()
        }

    def _checked_view(self, index: int, answer: Any, image: Tensor) -> PosedDepth:
        import torch

        from core_rasterizer import Camera, CameraError

        if not isinstance(answer, PosedDepth):
            raise PluginError(f"the answer has a {type(answer).__name__}, expected a `PosedDepth`")
        height, width = image.shape[:2]
        for name in ("depth", "confidence"):
            check_shape(name, getattr(answer, name), (height, width))
        check_shape("intrinsics", answer.intrinsics, (3, 3))
        pose = torch.eye(4, dtype=torch.float64)
        given = answer.world_to_camera
        check_shape(
            "world_to_camera",
            given,
            (4 if len(getattr(given, "shape", ())) and len(given) == 4 else 3, 4),
        )
        pose[:3] = given[:3].detach().double()
        (fx, _, cx), (_, fy, cy), _ = answer.intrinsics.tolist()
        try:
            Camera(pose, fx, fy, cx, cy, width, height)
        except CameraError as error:
            raise PluginError(
                f"the camera of photograph {index} is not valid: {error.what}", fix=error.fix
            ) from error
        depth, confidence = answer.depth.detach().float(), answer.confidence.detach().float()
        if self.confidences == "logits":
            confidence = confidence.sigmoid()
        elif bool((confidence < -_TOLERANCE).any() | (confidence > 1 + _TOLERANCE).any()):
            raise PluginError(
                f"the confidence is {float(confidence.min()):g} to {float(confidence.max()):g}, not 0 to 1",
                fix='return probabilities, or logits with `confidences = "logits"`',
            )
        valid = depth.isfinite() & (depth > 0) & confidence.isfinite()
        return replace(
            answer,
            world_to_camera=pose,
            intrinsics=answer.intrinsics.detach().double(),
            depth=depth.where(valid, 0.0),
            confidence=confidence.clamp(0, 1).where(valid, 0.0),
        )


def _fitted(right: Tensor, down: Tensor, depth: Tensor) -> Tensor:
    """Return the intrinsics `[3, 3]` whose focal length fits directions `[H, W]` (x / z, y / z) best.

    A picture of one pixel determines none: it is 1.
    """
    import torch

    height, width = depth.shape
    columns = (torch.arange(width) + 0.5 - width / 2).expand(height, width)
    rows = (torch.arange(height) + 0.5 - height / 2)[:, None].expand(height, width)
    known = right.isfinite() & down.isfinite() & (depth > 0)
    slopes = torch.cat([right[known], down[known]]).double()
    pixels = torch.cat([columns[known], rows[known]]).double()
    focal = (slopes @ pixels) / (slopes @ slopes) if depth.numel() > 1 else 1.0
    intrinsics = torch.eye(3, dtype=torch.float64)
    intrinsics[0, 0] = intrinsics[1, 1] = focal
    intrinsics[0, 2], intrinsics[1, 2] = width / 2, height / 2
    return intrinsics
