"""Plane sweep of posed views by feature vectors, over planes parallel to the image."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray
from .sweep_geometry import SOURCE_MACROS, SweepGeometry


class FeatureSweep:
    """Costs by the dot product of the feature vectors of corresponding pixels.

    Args:
        device: where to compute.
        features: `[C, H, W]` unit vectors over C for each camera, of the camera's size.
        cameras: of any sizes and principal points.
        inverse_depths: `[P]` > 0; 1 / z-depth of the planes in the reference camera, world units^-1.
        second_share: see `ZnccSweep`.

    Raises:
        ValueError: features have another size than their camera, or differ in channels; no plane.
    """

    def __init__(
        self,
        device: Device,
        features: Sequence[Tensor],
        cameras: Sequence[Camera],
        inverse_depths: Tensor,
        *,
        second_share: float = 0.25,
    ) -> None:
        self._device, self._cameras = device, tuple(cameras)
        self._second_share = second_share
        channels = features[0].shape[0]
        self._channels = -(-channels // device.lanes) * device.lanes
        ends = list(accumulate(camera.width * camera.height for camera in cameras))
        self._starts = [0, *ends[:-1]]
        self._geometry = SweepGeometry(device, cameras, self._starts, inverse_depths)
        self._features = DeviceArray(device, (ends[-1], self._channels))
        for values, camera, start, end in zip(features, cameras, self._starts, ends, strict=True):
            if tuple(values.shape) != (channels, camera.height, camera.width):
                raise ValueError(
                    f"features of shape {tuple(values.shape)} have a camera of "
                    f"{camera.width}x{camera.height}; the first view has {channels} channels"
                )
            rows = torch.zeros(end - start, self._channels)
            rows[:, :channels] = values.flatten(1).T
            self._features.write(rows, start, end)

    def costs(self, reference: int, sources: Sequence[int]) -> DeviceArray:
        """The cost of every plane at every pixel of one view: 127.5 (1 - the dot product).

        See `ZnccSweep.costs`.
        """
        numbers, layout = self._geometry.sources(reference, sources)
        costs = self._geometry.empty_volume(reference)
        planes, camera = self._geometry.planes, self._cameras[reference]
        planes_an_item = self._device.profile.sweep_planes
        program = self._device.program(
            "matching/feature_sweep",
            dtype=torch.float32,
            SOURCES=len(sources),
            **SOURCE_MACROS,
            CHANNELS=self._channels,
            PLANES_PER_ITEM=planes_an_item,
        )
        program.run(
            "feature_sweep",
            (planes // planes_an_item, camera.width, camera.height),
            None,
            features=self._features,
            sources=numbers,
            layout=layout,
            inverse_depths=self._geometry.inverse_depths,
            costs=costs,
            start=self._starts[reference],
            width=camera.width,
            planes=planes,
            second_share=self._second_share,
        )
        return costs
