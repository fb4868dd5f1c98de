"""LPIPS by AlexNet beside LPIPS by VGG, in every training that is measured."""

from __future__ import annotations

import yaml

from benchmarks.scores import ALEXNET, VGG
from registry.pipeline import Pipeline
from registry.session import build_pipeline


def with_alexnet(pipeline: Pipeline) -> Pipeline:
    """A pipeline that has LPIPS, with AlexNet's too; any other as it is.

    A planned training does not name it (`planned_training`): its records are good without.
    """
    names = [item.name for item in pipeline.items["metrics"]]
    if VGG not in names or ALEXNET in names:
        return pipeline
    written = yaml.safe_load(pipeline.to_yaml())
    written["metrics"].append({"use": VGG, "name": ALEXNET, "network": "alex"})
    return build_pipeline(written)
