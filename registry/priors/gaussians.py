"""Gaussians of posed photographs: the capability of feed-forward models."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.checks.scene import check_points
from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..contract.scene import PointCloud, TrainingView
from ..errors import PluginError
from .prior_cache import cached

if TYPE_CHECKING:
    from torch import Tensor

_KIND = "kinds/"


class GaussiansPrior(Prior[SettingsType]):
    """A prior that estimates the Gaussians of a scene from posed photographs."""

    capability: ClassVar[str] = "gaussians"

    @abstractmethod
    def estimate(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> PointCloud:
        """Return Gaussians in the world of the cameras: means, standard deviations, (w, x, y, z), SH or RGB.

        `PointCloud.transformed` turns those of a network with other coordinates, for example
        `answer.transformed(views[0].camera.camera_to_world)` if they are relative to the first camera.

        Args:
            views: one or more; `image` is `[H, W, 3]` in [0, 1], and `camera` has `intrinsics` `[3, 3]` in
                pixels and `camera_to_world` `[4, 4]` (x right, y down, z forward).
            bounds: (near, far) z-depth of the scene's content, world units.
        """

    def gaussians(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> PointCloud:
        """Return Gaussians; cached on disk.

        Raises:
            PluginError: the estimate is not a `PointCloud`, or has maps, pictures or facts.
            SceneError: a shape or value is not valid (`registry.PointCloud`).
        """
        found = cached(self, views, [bounds], lambda: self._checked(views, bounds), lambda _: {})
        kinds = {name.removeprefix(_KIND): x for name, x in found.items() if _KIND in name}
        fields: dict[str, Any] = {name: x for name, x in found.items() if _KIND not in name}
        return PointCloud(**fields, kinds=kinds)

    def _checked(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> dict[str, Tensor]:
        from torch import Tensor

        with self.context.at_work():
            answer: Any = self.estimate(views, bounds)
            if not isinstance(answer, PointCloud):
                got = type(answer).__name__
                raise PluginError(f"the answer is a {got}, expected a `registry.PointCloud`")
            if answer.maps or answer.pictures or answer.facts:
                raise PluginError(
                    "the answer has maps, pictures or facts",
                    fix="return the Gaussians alone; an initializer may add the others",
                )
            check_points(answer, self.context.name)
        tensors = {name: x for name, x in vars(answer).items() if isinstance(x, Tensor)}
        tensors |= {f"{_KIND}{name}": mask for name, mask in answer.kinds.items()}
        return {name: x.detach().cpu() for name, x in tensors.items()}
