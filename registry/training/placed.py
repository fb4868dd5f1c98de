"""What leaves a run, in the coordinates of the scene's files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence

from torch import Tensor

from core_rasterizer import Camera, GaussianReader, Gaussians, Model, Rendering

from ..confidence import Confidence
from ..contract.frame import Frame


class PlacedGaussians(GaussianReader):
    """Gaussians of a training, read and rendered in the coordinates of the scene's files.

    Means are float64; cameras and depths are in the file's coordinates and units.
    """

    def __init__(
        self, model: Model, frame: Frame, attributes: Mapping[str, Tensor] | None = None
    ) -> None:
        super().__init__(model, attributes)
        self._frame = frame

    def digest(self) -> str:
        """Return the SHA-256 of all parameters in the frame of training, hexadecimal: `Run.hash`.

        If there are attributes, it covers them too.
        """
        if not self.attributes:
            return self._model.digest()
        hasher = hashlib.sha256(self._model.digest().encode())
        for name, values in sorted(self.attributes.items()):
            hasher.update(f"{name} {values.dtype} ".encode() + values.detach().numpy().tobytes())
        return hasher.hexdigest()

    def read(self, name: str) -> Tensor:
        """Return one parameter; see `GaussianReader.read`."""
        return self._placed(name, super().read(name))

    def parameter(self, name: str) -> Tensor:
        """Return one parameter in autograd; see `GaussianReader.parameter`."""
        return self._placed(name, super().parameter(name))

    def scales(self) -> Tensor:
        """Return activated scales `[N, 3]`, in the file's units."""
        return self._placed("scales", super().scales())

    def gaussians(self) -> Gaussians:
        """Return a copy of all Gaussians on the host."""
        return self._frame.gaussians_in_file(super().gaussians())

    def render(self, camera: Camera, *, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Rendering:
        """Render a camera of the file; see `GaussianReader.render`."""
        rendering = super().render(self._frame.camera_of_file(camera), background=background)

        def image(name: str) -> Tensor:
            found: Tensor = getattr(rendering, name)
            return found * self._frame.unit if name == "depth" else found

        return Rendering.lazy(image)

    def _placed(self, name: str, values: Tensor) -> Tensor:
        match name:
            case "means":
                return self._frame.points_in_file(values)
            case "log_scales":
                return values + math.log(self._frame.unit)
            case "scales":
                return values * self._frame.unit
        return values


class PlacedConfidence(Confidence):
    """Confidence in renders of cameras in the file's coordinates."""

    def __init__(self, inner: Confidence, frame: Frame) -> None:
        self._inner, self._frame = inner, frame

    def of(self, camera: Camera) -> Tensor:
        """Return `[H, W]` in [0, 1]; see `Confidence.of`."""
        return self._inner.of(self._frame.camera_of_file(camera))

    def gain(self, camera: Camera) -> float:
        """Return how much a photograph would add; see `Confidence.gain`."""
        return self._inner.gain(self._frame.camera_of_file(camera))
