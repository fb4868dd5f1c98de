"""Answers of components in two other processes."""

from __future__ import annotations

import argparse
import logging
from dataclasses import replace

import pytest
from torch import Tensor

from core_rasterizer import Device
from registry import PluginError, Regularizer, Settings, Step
from registry.testing import tiny_scene
from stereogs import RunOptions, train
from stereogs.api import TrainRequest
from stereogs.verbs.other_processes import OtherProcesses, answers_of, refuse_different_answers
from tests.host import TrainingSettings, pipeline_item, pipeline_of


class Hashing(Regularizer[Settings]):
    """Depends on PYTHONHASHSEED."""

    def loss(self, step: Step) -> Tensor:
        return step.rendering.alpha.mean() * (1 + hash("text") % 1000)


TRAINING = TrainingSettings(iterations=600, sh_degree=0)


@pytest.mark.proof
def test_an_answer_that_depends_on_the_hash_seed_is_named(device: Device) -> None:
    """In a component that is called late; before the first iteration of the run."""
    item = pipeline_item(Hashing, Settings(), "hashing")
    late = replace(item, host=item.host.model_copy(update={"start": 500}))
    request = TrainRequest(argparse.Namespace(), 0.0)
    options = RunOptions(scene=tiny_scene(), device=device, progress=False, check_plugins=True)
    begun: list[int] = []
    options = replace(options, on_begin=lambda run: begun.append(run.iteration))
    with (
        OtherProcesses().running(request, options) as chosen,
        pytest.raises(PluginError, match="different answers in two processes") as caught,
    ):
        train(pipeline_of([late], TRAINING), chosen)
    assert "'hashing'" in caught.value.where
    assert begun == []


def test_answers_are_recorded_and_equal_bits_have_equal_digests(device: Device) -> None:
    pipeline = pipeline_of([pipeline_item(Hashing, Settings(), "hashing")], TRAINING).scaled(3)
    first, second = (answers_of(pipeline, tiny_scene(), device.name) for _ in range(2))
    assert first == second
    names = [name for name, _ in first]
    assert names[0] == "initializer.scene_points"
    assert names.count("regularizers.hashing") == 4, "three calls, and one of a copy"
    assert names.count("metrics.mean_error") >= 2
    assert all(digests for _, digests in first)


def test_unchecked_runs_start_no_process() -> None:
    options = RunOptions()
    with OtherProcesses().running(TrainRequest(argparse.Namespace(), 0.0), options) as chosen:
        assert chosen is options


def test_a_component_that_no_other_process_can_import_is_reported(
    device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    class Local(Hashing):
        pass

    pipeline = pipeline_of([pipeline_item(Local, Settings(), "local")], TRAINING)
    with caplog.at_level(logging.WARNING, "stereogs"):
        refuse_different_answers(pipeline, tiny_scene(), device.name)
    assert "not compared between processes" in caplog.text
