"""`script_metric`: depth in metres, and what the photograph shows beyond it, from a TorchScript file.

priors: [{use: script_metric, model: /models/metric.pt}]
regularizers: [{use: pearson_depth, prior: script_metric, weight: 0.05}]
"""

import io
from pathlib import Path

import torch

from registry.toolkit.networks import read_model_file
from stereogs import api


class ScriptMetricSettings(api.Settings):
    model: Path
    """TorchScript file. `forward` takes `[1, 3, H, W]` in [0, 1] and returns depth `[1, H, W]` in metres,
    the focal length `[1]` in pixels, and logits `[1, H, W]` that are positive where depth is known."""


class ScriptMetric(api.MonocularDepthPrior[ScriptMetricSettings]):
    def __init__(self, settings: ScriptMetricSettings, context: api.Context) -> None:
        super().__init__(settings, context)
        file = read_model_file(settings.model, sha256=None)
        self._module = torch.jit.load(io.BytesIO(file.content), map_location="cpu").eval()

    def estimate(self, image: torch.Tensor) -> api.MonocularDepth:
        height, width = image.shape[:2]
        depth, focal, known = self._module(image.permute(2, 0, 1)[None])
        lens = torch.eye(3)
        lens[0, 0] = lens[1, 1] = focal[0]
        lens[0, 2], lens[1, 2] = width / 2, height / 2
        return api.MonocularDepth(
            depth[0],
            inverse=False,
            ambiguity="metric",
            valid=known[0] > 0,
            confidence=known[0].sigmoid(),
            intrinsics=lens,
        )


@api.hookimpl
def stereogs_register_priors(register: api.Register[ScriptMetric]) -> None:
    register("script_metric", ScriptMetric)
