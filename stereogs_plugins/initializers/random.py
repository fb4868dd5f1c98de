"""`random`: points anywhere that a training camera can see; needs no image features."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Initializer, PointCloud, Prior, Register, Settings, TrainingScene, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping


class RandomSettings(Settings):
    count: int = Field(10_000, ge=1)
    """Number of points."""


class RandomInitializer(Initializer[RandomSettings]):
    """Points in the frusta of the training cameras, with the colours of the pixels that they project onto.

    Each point has a random training camera, a random pixel position, and an inverse depth that is uniform
    between the scene's bounds.
    """

    ablation_baseline = "sfm"

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return `count` points."""
        import torch

        count = self.settings.count
        choice = torch.randint(len(scene.train), (count,), generator=self.generator)
        u, v, w = torch.rand(3, count, generator=self.generator, dtype=torch.float64)
        near, far = scene.bounds
        depth = 1 / torch.lerp(torch.full_like(w, 1 / far), torch.full_like(w, 1 / near), w)
        positions = torch.empty(count, 3)
        colors = torch.empty(count, 3)
        for index, view in enumerate(scene.train):
            mine = choice == index
            camera = view.camera
            x, y = u[mine] * camera.width, v[mine] * camera.height
            positions[mine] = camera.unproject(x, y, depth[mine]).float()
            colors[mine] = view.image[y.long(), x.long()]
        return PointCloud(positions=positions, colors=colors)


@hookimpl
def stereogs_register_initializers(register: Register[RandomInitializer]) -> None:
    register("random", RandomInitializer)
