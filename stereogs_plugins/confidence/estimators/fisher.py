"""`fisher`: how well the training photographs determine the Gaussians (FisherRF, Jiang et al. 2024)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from registry.confidence import Confidence, Trained
from registry.toolkit.views import same_model

from .painted import Painted

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from torch import Tensor

    from core_rasterizer import Camera, GaussianModel


PARAMETERS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


class FisherConfidence(Confidence):
    """Information about the Gaussians' parameters from the training views, and from other cameras.

    Args:
        trained: Gaussians and training views; photographs are not used, only their cameras.
        prior, probes: see `FisherSettings`.
        generator: for the probes.

    Attributes:
        information: `[N, ...]` by parameter, as in `GaussianReader.read`: the diagonal of the sum of
            J^T J over the training views, J the Jacobian of a render.
    """

    def __init__(
        self, trained: Trained, prior: float, probes: int, generator: torch.Generator
    ) -> None:
        self._model, self._prior, self._probes = same_model(trained.model), prior, probes
        self._generator = generator
        self.information = self.information_of(view.camera for view in trained.scene.train)
        total = torch.stack([v.reshape(len(v), -1).sum(1) for v in self.information.values()]).sum(
            0
        )
        self._painted = Painted(trained.model, (total / (total + prior))[:, None])

    def information_of(self, cameras: Iterable[Camera]) -> dict[str, Tensor]:
        """Return the diagonal of the Fisher information of cameras' renders, summed over the cameras.

        With r random signs for all pixels and channels, the squares of J^T r have the mean diag(J^T J)
        (Hutchinson 1990), so that a backward pass per probe is enough.
        """
        sums = {name: torch.zeros_like(self._model.read(name)) for name in PARAMETERS}
        for camera in cameras:
            for _ in range(self._probes):
                for name, gradient in _gradients(self._model, camera, self._generator).items():
                    sums[name] += gradient**2 / self._probes
        return sums

    def of(self, camera: Camera) -> Tensor:
        """Return the share of each pixel's light that photographs, not the prior, determine."""
        return self._painted.render(camera)[..., 0].clamp(0, 1)

    def gain(self, camera: Camera) -> float:
        """Return the expected information gain of a photograph: the sum of H_camera / (H_train + lambda)."""
        return self.gain_beyond(self.information, camera)

    def gain_beyond(self, known: Mapping[str, Tensor], camera: Camera) -> float:
        """Return the gain of a photograph when `known`, like `information`, is known already."""
        added = self.information_of([camera])
        return float(sum((added[name] / (known[name] + self._prior)).sum() for name in PARAMETERS))


def _gradients(
    model: GaussianModel, camera: Camera, generator: torch.Generator
) -> dict[str, Tensor]:
    """Return J^T r by parameter, for random signs r."""
    model.zero_gradients()
    rgb = model.render(camera).rgb
    signs = torch.randint(0, 2, rgb.shape, generator=generator).to(rgb.dtype) * 2 - 1
    rgb.backward(signs)
    return {name: model.gradient(name).clone() for name in PARAMETERS}
