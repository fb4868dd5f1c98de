"""`camera_refinement`: optimize small corrections of the training cameras (BARF, Lin et al. 2021).

Estimated cameras are off by a fraction of a pixel, which blurs or doubles details. Each training pose has
a small rigid motion, trained together with the Gaussians by the gradient of the rendered image. The mean
over the views stays zero: a common motion of all cameras would move the scene relative to the test views,
which are never refined.

Do not use it with exact poses: it then fits noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import (
    ParameterGroup,
    Register,
    Sample,
    Sampler,
    Settings,
    Step,
    TrainingScene,
    hookimpl,
)
from registry.toolkit.views import ViewParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor


class CameraRefinementSettings(Settings):
    rotation_rate: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """Adam's learning rate of the rotations, radians: at a focal length of 400 pixels 1e-4 is 0.04 pixels."""
    translation_rate: float = Field(1e-4, ge=0, allow_inf_nan=False)
    """Adam's learning rate of the translations, in units of the scene's extent."""


class CameraRefinement(Sampler[CameraRefinementSettings]):
    """world_to_camera <- exp([omega]x, v) world_to_camera, for each view's rotation omega and motion v."""

    def begin_training(self, scene: TrainingScene) -> None:
        """Give every training view a motion, initially zero."""
        self._extent = scene.extent
        self._rotations = ViewParameters(scene, (3,))
        self._translations = ViewParameters(scene, (3,))

    def parameters(self) -> Sequence[ParameterGroup]:
        """Return the views' rotation vectors, radians, and translations, in units of the scene's extent."""
        return [
            self._rotations.group("rotations", self.settings.rotation_rate),
            self._translations.group("translations", self.settings.translation_rate),
        ]

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with the view's camera moved, in autograd.

        Logs the size of the motion, radians and units of training.
        """
        rotation = self._rotations.of(sample.view)
        translation = self._extent * self._translations.of(sample.view)
        step.log(f"{self.context.name}_rotation", float(rotation.detach().norm()))
        step.log(f"{self.context.name}_translation", float(translation.detach().norm()))
        pose = rigid_motion(rotation, translation) @ sample.camera.world_to_camera
        return replace(sample, camera=replace(sample.camera, world_to_camera=pose))


def rigid_motion(rotation: Tensor, translation: Tensor) -> Tensor:
    """Return the exponential of a twist, `[4, 4]` float64, in autograd.

    Args:
        rotation: omega `[3]`, float64: the axis times the angle in radians.
        translation: v `[3]`, float64; equals the translation if omega is 0.
    """
    import torch

    x, y, z = rotation
    zero = torch.zeros((), dtype=torch.float64)
    rows = (
        torch.stack([zero, -z, y, translation[0]]),
        torch.stack([z, zero, -x, translation[1]]),
        torch.stack([-y, x, zero, translation[2]]),
        torch.zeros(4, dtype=torch.float64),
    )
    motion: Tensor = torch.linalg.matrix_exp(torch.stack(rows))
    return motion


@hookimpl
def stereogs_register_samplers(register: Register[CameraRefinement]) -> None:
    register("camera_refinement", CameraRefinement)
