"""Files of a run folder for a report; optional files may be missing."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import yaml

from registry import RunError
from registry.runs import read_results

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from core_rasterizer import Camera

CHECKPOINT = "checkpoint"
"""Folder of a run's Gaussians; optional."""


@dataclass(frozen=True)
class RunFiles:
    """Contents of a run folder.

    Args:
        results: results.json.
        provenance: provenance.json.
        pipeline: pipeline.yaml as text.
        metrics: the lines of metrics.jsonl, in order.
        initialization: the initializer's facts.
        initial_pictures: the initializer's pictures, sorted by name.
    """

    results: dict[str, Any]
    provenance: dict[str, Any]
    pipeline: str
    metrics: Sequence[dict[str, Any]]
    initialization: dict[str, Any]
    initial_pictures: tuple[Path, ...]

    @cached_property
    def training(self) -> dict[str, Any]:
        """The pipeline's training settings, or an empty mapping."""
        content = yaml.safe_load(self.pipeline)
        return dict(content.get("training") or {}) if isinstance(content, dict) else {}


def read_run(folder: Path) -> RunFiles:
    """Read a run folder.

    Raises:
        RunError: results.json is missing or inconsistent, or another file is damaged.
    """
    if not (folder / "results.json").is_file():
        raise RunError(
            "the run has no results.json",
            where=str(folder),
            fix=f"finish the training: stereogs resume {folder}",
        )
    pipeline, metrics = folder / "pipeline.yaml", folder / "metrics.jsonl"
    lines = metrics.read_text("utf-8").splitlines() if metrics.is_file() else []
    return RunFiles(
        results=read_results(folder / "results.json"),
        provenance=_json_file(folder / "provenance.json"),
        pipeline=pipeline.read_text("utf-8") if pipeline.is_file() else "",
        metrics=[_object(line, f"{metrics}:{number}") for number, line in enumerate(lines, 1)],
        initialization=_json_file(folder / "initialization" / "facts.json"),
        initial_pictures=tuple(sorted((folder / "initialization").glob("*.png"))),
    )


def suggested_cameras(folder: Path, iterations: int | None) -> dict[str, Camera]:
    """Return the cameras that `stereogs next` suggested for a run, best first, by where to stand.

    Args:
        folder: of the run.
        iterations: of the run, None if unknown; what was suggested after another one is left out.

    Raises:
        RunError: its file is damaged.
    """
    from core_rasterizer import Camera
    from registry.toolkit.photos import pose_from_opengl

    file = folder / "next" / "next.json"
    content = _json_file(file)
    if content.get("iteration", iterations) != iterations:
        return {}
    try:
        return {
            f"{number}: {str(one['words']).partition(';')[0]}": Camera(
                pose_from_opengl(one["transform_matrix"], str(file)),
                *(one[name] for name in ("fl_x", "fl_y", "cx", "cy", "w", "h")),
            )
            for number, one in enumerate(content.get("frames", ()), start=1)
        }
    except (KeyError, TypeError) as error:
        fix = f"write it again: stereogs next {folder}"
        raise RunError(f"it does not list cameras: {error}", where=str(file), fix=fix) from error


def _json_file(path: Path) -> dict[str, Any]:
    return _object(path.read_text("utf-8"), str(path)) if path.is_file() else {}


def _object(text: str, where: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except ValueError as error:
        raise RunError(f"not JSON: {error}", where=where) from error
    if not isinstance(content, dict):
        raise RunError(f"expected a JSON object, not {type(content).__name__}", where=where)
    return content
