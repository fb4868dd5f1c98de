"""`html`: a run as one page, report.html: the scene in 3D, scores, pictures and training curves.

The page embeds its pictures and, unless `beside` is set, the Gaussians and the viewer, so that it can be
mailed or moved. It does not access the network.
"""

from __future__ import annotations

import shlex
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Any

import pydantic

from registry import Register, Report, Scene, Settings, hookimpl
from registry.system import write_text
from registry.toolkit.photos import in_parallel
from registry.toolkit.web_page import (
    Cell,
    choice,
    facts_table,
    figure,
    folded,
    headings,
    image,
    note,
    page,
    score_table,
    section,
    subsection,
    verbatim,
)

from .run_files import CHECKPOINT, RunFiles, read_run

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .scene_view import SceneView

FILE = "report.html"


class HtmlReportSettings(Settings):
    beside: bool = False
    """Write the Gaussians and the viewer to files next to the page instead of embedding them."""
    largest_mb: Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)] = 20.0
    """Largest embedded scene, megabytes; without `beside`, a larger scene has no 3D view."""


class HtmlReport(Report[HtmlReportSettings]):
    """Writes report.html into the run folder."""

    def write(self, folder: Path, scene: Scene) -> list[Path]:
        """Write report.html and the files next to it, and return their paths.

        Raises:
            RunError: a file of the run is missing or damaged.
        """
        from .scene_view import remove_beside
        from .scores import scores
        from .training_plots import training_plots
        from .unseen_views import unseen_views

        run = read_run(folder)
        title = f"{scene.name}: {run.results['pipeline']}"
        remove_beside(folder)
        view = self._scene_view(folder, scene, run)
        contents = [
            _summary(run),
            section("The scene in 3D", view.content),
            section("Test views", unseen_views(run.results, scene, folder)),
            section("Scores", scores(run.results)),
            section("Training", training_plots(run.metrics, run.results)),
            section("Initialization", _initialization(run)),
            section("Pipeline", folded("every setting", verbatim(run.pipeline))),
            section("Scene", facts_table(run.results["scene"])),
            section("Provenance", folded("every version", facts_table(run.provenance))),
        ]
        write_text(folder / FILE, page(title, contents))
        return [folder / FILE, *view.files]

    def _scene_view(self, folder: Path, scene: Scene, run: RunFiles) -> SceneView:
        from registry.runs import trained_gaussians

        from .scene_view import SceneView, scene_view

        if not (folder / CHECKPOINT).is_dir():
            return SceneView("")
        return scene_view(
            trained_gaussians(folder),
            scene,
            run.training,
            folder,
            beside=self.settings.beside,
            largest_mb=self.settings.largest_mb,
        )


def _summary(run: RunFiles) -> str:
    """Return a table of scores, cost, device and command; unknown values are omitted."""
    from .scores import score, with_unit

    results, origin = run.results, run.provenance
    missing = results.get("unavailable", {})
    means = {
        f"test {with_unit(metric)}": score(results["test"], metric, missing)
        for metric in results["test"]
        if metric not in missing
    }
    labels = {
        "gaussians": "Gaussians",
        "iterations": "iterations",
        "seconds": "training time, s",
        "iterations_per_second": "iterations per second",
        "peak_memory_mb": "peak memory, MB",
    }
    source = origin.get("source") or {}
    changed = " with changes" if source.get("dirty") else ""
    facts = {
        "date": str(origin.get("started", "")).replace("T", " ").replace("+00:00", " UTC") or None,
        "device": origin.get("device", {}).get("name"),
        "command": _command(origin.get("command", [])) or None,
        "commit": f"{source['commit']}{changed}" if "commit" in source else None,
        "SHA-256 of the Gaussians": results.get("hash"),
    }
    known = {label: text for label, text in facts.items() if text is not None}
    return facts_table(
        means | {label: results[key] for key, label in labels.items() if key in results} | known
    )


def _command(command: list[str]) -> str:
    """Return the command without the program's private path."""
    return shlex.join([PurePath(part).name if k == 0 else part for k, part in enumerate(command)])


def _initialization(run: RunFiles) -> str:
    """Return points by kind, the initializer's pictures, and its other facts."""
    separate = (_BY_KIND, _COLUMNS, _BY_VIEW)
    facts = {name: value for name, value in run.initialization.items() if name not in separate}
    columns = headings(run.initialization.get(_COLUMNS, ()))
    paths = run.initial_pictures
    figures = in_parallel(lambda path: figure(path.stem, columns + image(path, path.stem)), paths)
    pictures = {path.stem: its for path, its in zip(paths, figures, strict=True)}
    by_kind: Mapping[str, int] = run.initialization.get(_BY_KIND, {})
    return (
        subsection("Initial points by kind", _kinds(by_kind))
        + subsection("Pictures", choice("picture", pictures) + note(_COLORS) if pictures else "")
        + subsection("Facts", facts_table(facts))
        + folded("facts of each view", facts_table(run.initialization.get(_BY_VIEW, {})))
    )


_BY_KIND, _COLUMNS, _BY_VIEW = "points_by_kind", "picture_columns", "views"
_COLORS = "Depths: near is yellow, far is dark blue, unknown is black."


def _kinds(by_kind: Mapping[str, int]) -> str:
    total = sum(by_kind.values())
    rows: list[list[Any]] = [
        [Cell(kind.replace("_", " ")), Cell(f"{count:,}"), Cell(f"{count / total:.1%}")]
        for kind, count in by_kind.items()
        if total
    ]
    return score_table(["kind", "points", "share"], rows) if rows else ""


@hookimpl
def stereogs_register_reports(register: Register[HtmlReport]) -> None:
    register("html", HtmlReport)
