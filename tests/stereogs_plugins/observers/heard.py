"""Runs for loggers to listen to."""

from __future__ import annotations

from pathlib import Path

import pytest

import stereogs
from registry import PluginError
from registry.testing import tiny_scene

CURVES = {"loss", "photometric", "gaussians", "seconds", "learning_rates/means"}


def pipeline(name: str, **more: object) -> dict[str, object]:
    """Six iterations; the logger hears of the even ones, and draws a picture in the fourth."""
    return {
        "name": "heard",
        "initializer": {"use": "random", "count": 50},
        "metrics": ["psnr"],
        "observers": [{"use": name, "every": 2, "pictures_every": 4}],
        "training": {"iterations": 6, "sh_degree": 0, "evaluate_every": 4},
        **more,
    }


def stopped_and_resumed(name: str, out: Path) -> tuple[stereogs.Run, Path]:
    """A run that was stopped after iteration 4, and the folder in which the logger wrote."""
    scene = tiny_scene()
    half = stereogs.train(
        pipeline(name),
        scene=scene,
        out=out,
        progress=False,
        callback=lambda done: done.number < 4,
    )
    assert not half.finished
    run = stereogs.resume(out, scene=scene, progress=False)
    assert run.finished
    return run, out / "observers" / name


def failed(name: str, out: Path) -> Path:
    """The folder in which the logger wrote while a run fails in its third iteration."""
    growth = {"use": "gradient_threshold", "every": 1, "stop": None}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "stereogs_plugins.densification.gradient_threshold.GradientThreshold.refine", _fail
        )
        with pytest.raises(PluginError, match="no such luck"):
            stereogs.train(
                pipeline(name, densification=growth), scene=tiny_scene(), out=out, progress=False
            )
    return out / "observers" / name


def _fail(self: object, step: object) -> None:
    if getattr(step, "iteration", 0) == 3:
        raise ValueError("no such luck")
