"""Evaluation of NerfBaselines methods by the metrics of a sparse-view protocol."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
import torch
from nerfbaselines import Dataset
from nerfbaselines.evaluation import DefaultEvaluationProtocol

from core_rasterizer import open_device
from registry import Metric, Unavailable
from registry.pipeline import build_part

from .nerfbaselines_datasets import EVALUATION, PREFIX, pipeline_of

Scores = dict[str, float | int]


class ProtocolScores(DefaultEvaluationProtocol):  # type: ignore[misc]  # see nerfbaselines_method
    """The protocol's metrics with their settings and masks; means over the views.

    Unavailable metrics (`lpips` without its network's file) are omitted.
    """

    def get_name(self) -> str:
        """Return the name used in results."""
        return EVALUATION

    def evaluate(self, predictions: dict[str, Any], dataset: Dataset) -> Scores:
        """Return the scores of one view.

        Args:
            predictions: `color` `[H, W, 3]`, bytes or in [0, 1].
            dataset: a dataset made by `prepare`, reduced to this view.
        """
        rendered, photograph = (_image(x) for x in (predictions["color"], dataset["images"][0]))
        masks = dataset.get("masks")
        mask = None if masks is None else torch.from_numpy(np.asarray(masks[0]) > 0)
        scores: Scores = {}
        for name, metric in _metrics(dataset["metadata"]["id"].removeprefix(PREFIX)).items():
            score = metric.measure(rendered, photograph, mask)
            if not isinstance(score, Unavailable):
                scores[name] = score
        return scores

    def accumulate_metrics(self, metrics: Iterable[Scores]) -> Scores:
        """Return the mean of each metric."""
        rows = list(metrics)
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


@cache
def _metrics(protocol: str) -> dict[str, Metric[Any]]:
    pipeline = pipeline_of(protocol)
    device = open_device()
    parts = (build_part(i, pipeline.training.seed, device) for i in pipeline.items["metrics"])
    return {part.item.name: part.component for part in parts}


def _image(values: Any) -> torch.Tensor:
    array = np.asarray(values)[..., :3]
    scale = 255 if array.dtype == np.uint8 else 1
    return torch.from_numpy(array.astype(np.float32) / scale).clamp(0, 1)
