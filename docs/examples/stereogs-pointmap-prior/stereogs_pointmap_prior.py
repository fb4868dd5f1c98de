"""`script_pointmap`: cameras and points of photographs without cameras, from a TorchScript file.

scene: {use: photos, path: my_photos, cameras: script_pointmap}
priors: [{use: script_pointmap, model: /models/pointmap.pt}]
"""

import io
from collections.abc import Sequence
from pathlib import Path

import torch
from pydantic import Field
from torch.nn.functional import interpolate

from registry.toolkit.images import at_size
from registry.toolkit.networks import read_model_file
from stereogs import api


class ScriptPointmapSettings(api.Settings):
    model: Path
    """TorchScript file. `forward` takes photographs `[V, 3, h, w]` in [0, 1] and returns points
    `[V, h, w, 3]` of one world, world to camera `[V, 4, 4]`, and logits of confidence `[V, h, w]`."""
    size: tuple[int, int] = (392, 294)
    """[width, height] to which photographs are stretched for the network."""
    max_views: int | None = Field(None, ge=2)
    """Largest number of photographs that the network accepts; null: no limit."""


class ScriptPointmap(api.PosedDepthPrior[ScriptPointmapSettings]):
    confidences = "logits"

    def __init__(self, settings: ScriptPointmapSettings, context: api.Context) -> None:
        super().__init__(settings, context)
        file = read_model_file(settings.model, sha256=None)
        self._module = torch.jit.load(io.BytesIO(file.content), map_location="cpu").eval()
        self.accepted_views = (2, settings.max_views)

    def estimate(
        self, images: Sequence[torch.Tensor], intrinsics: Sequence[torch.Tensor | None]
    ) -> list[api.PosedDepth]:
        width, height = self.settings.size
        batch = [
            interpolate(x.permute(2, 0, 1)[None], (height, width), mode="area") for x in images
        ]
        points, poses, logits = self._module(torch.cat(batch))
        return [
            api.PosedDepth.from_points(
                at_size(points[k], *image.shape[:2]), poses[k], at_size(logits[k], *image.shape[:2])
            )
            for k, image in enumerate(images)
        ]


@api.hookimpl
def stereogs_register_priors(register: api.Register[ScriptPointmap]) -> None:
    register("script_pointmap", ScriptPointmap)
