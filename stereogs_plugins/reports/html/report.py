"""`html`: a run as one page, report.html: the scene in 3D, renders beside photographs, numbers.

The page embeds its pictures and, unless `beside` is set, the Gaussians and the viewer, so that it can be
mailed or moved. It does not access the network.
"""

from __future__ import annotations

import shlex
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Any

import pydantic

from registry import Register, Report, Scene, Settings, hookimpl
from registry.toolkit import write_text
from registry.toolkit.progress import in_parallel
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

from .run_files import CHECKPOINT, RunFiles, read_run, suggested_cameras

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
        from .confidence import confidence
        from .renders import renders
        from .scene_view import licenses, remove_beside
        from .scores import summary, views
        from .training_plots import training_plots
        from .words import about_photographs, kind_of_scores, lead

        run = read_run(folder)
        remove_beside(folder)
        view = self._scene_view(folder, scene, run)
        scored = "Held-out photographs" if scene.test else "Training photographs"
        contents = [
            view.content,
            note(lead(run.results, scene)),
            section(f"{scored} and renders", renders(run.results, scene, folder)),
            section("What is guessed", confidence(folder, run.results.get("iterations"))),
            section("Numbers", note(kind_of_scores(scene)) + summary(run.results)),
            folded("scores of each photograph", views(run.results)),
            section("Training", training_plots(run.metrics, run.results)),
            section("First points", _initialization(run)),
            section("Photographs", note(" ".join(about_photographs(scene)))),
            folded("Provenance", _provenance(run) + (licenses() if view.content else "")),
        ]
        write_text(folder / FILE, page(f"{scene.name}: {run.results['pipeline']}", contents))
        return [folder / FILE, *view.files]

    def _scene_view(self, folder: Path, scene: Scene, run: RunFiles) -> SceneView:
        from registry.runs import trained_gaussians

        from .scene_view import SceneView, pack, view_beside, view_inside

        if not (folder / CHECKPOINT).is_dir():
            return SceneView("")
        dilation = run.training.get("dilation", 0.3)
        compensate = run.training.get("compensate_dilation", False)
        found = suggested_cameras(folder, run.results.get("iterations"))
        suggested = {words: scene.frame.camera_of_file(camera) for words, camera in found.items()}
        packed = pack(trained_gaussians(folder), scene, dilation, compensate, suggested)
        if self.settings.beside:
            return view_beside(packed, folder)
        megabytes = len(packed.splats) / 1e6
        if megabytes > self.settings.largest_mb:
            return SceneView(note(_too_large(folder, megabytes, self.settings.largest_mb)))
        return view_inside(packed)


def _too_large(folder: Path, megabytes: float, largest: float) -> str:
    return (
        f"The Gaussians take {megabytes:.0f} MB; at most {largest:g} MB are embedded. "
        f"`stereogs report {shlex.quote(str(folder))} --beside` writes them to files next to the page."
    )


def _provenance(run: RunFiles) -> str:
    """Return what is needed to repeat the run: command, settings, versions, hash."""
    origin = run.provenance
    source = origin.get("source") or {}
    changed = " with changes" if source.get("dirty") else ""
    facts = {
        "date": str(origin.get("started", "")).replace("T", " ").replace("+00:00", " UTC") or None,
        "command": _command(origin.get("command", [])) or None,
        "commit": f"{source['commit']}{changed}" if "commit" in source else None,
        "SHA-256 of the Gaussians": run.results.get("hash"),
    }
    known = {label: text for label, text in facts.items() if text is not None}
    return (
        facts_table(known)
        + subsection("Pipeline", verbatim(run.pipeline))
        + subsection("Scene", facts_table(run.results["scene"]))
        + subsection("Versions", facts_table(origin))
    )


def _command(command: list[str]) -> str:
    """Return the command without the program's private path."""
    return shlex.join([PurePath(part).name if k == 0 else part for k, part in enumerate(command)])


def _initialization(run: RunFiles) -> str:
    """Return the initializer's pictures, points by kind, and other facts."""
    from .words import label

    separate = (_BY_KIND, _COLUMNS, _BY_VIEW)
    facts = {
        label(name): value for name, value in run.initialization.items() if name not in separate
    }
    columns = headings(run.initialization.get(_COLUMNS, ()))
    paths = run.initial_pictures
    figures = in_parallel(lambda path: figure(path.stem, columns + image(path, path.stem)), paths)
    pictures = {path.stem: its for path, its in zip(paths, figures, strict=True)}
    by_kind: Mapping[str, int] = run.initialization.get(_BY_KIND, {})
    return (
        (choice("picture", pictures) + note(_COLORS) if pictures else "")
        + _kinds(by_kind)
        + folded("more about the first points", facts_table(facts))
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
    return score_table(["kind of point", "points", "share"], rows) if rows else ""


@hookimpl
def stereogs_register_reports(register: Register[HtmlReport]) -> None:
    register("html", HtmlReport)
