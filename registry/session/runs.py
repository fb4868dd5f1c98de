"""Runs that were made earlier: opened, rendered, and written for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.checks.scene import validate
from ..contract.scene import Scene
from ..pipeline.edits import SECTIONS
from ..pipeline.pipeline import Item
from ..plugins.discovery import Plugins
from .arguments import device_of, run_folder
from .pipelines import PathLike

if TYPE_CHECKING:
    from core_rasterizer import Camera, Device, GaussianModel

    from ..runs.run import Picture, Run


def open_run(
    folder: PathLike,
    *,
    scene: Scene | None = None,
    device: Device | str | None = None,
    accept_changed_inputs: bool = False,
) -> Run:
    """A run that was made earlier: its pipeline, scene and Gaussians as its folder keeps them.

    Args:
        folder: what training wrote.
        scene: what it was trained on, if that was made in memory.
        device: see `train`.

    Raises:
        ExplainedError: the folder is no run, or something in it cannot be read.
    """
    path = run_folder(folder)
    from ..runs.opened import open_run as opened
    from ..training.threads import one_torch_thread

    with one_torch_thread():
        return opened(
            path,
            plugins=Plugins(),
            device=device_of(device),
            scene=scene and validate(scene),
            accept_changed_inputs=accept_changed_inputs,
        )


def export(
    run: Run,
    format_name: str,
    folder: PathLike | None = None,
    *,
    changes: Sequence[str] = (),
    without: Sequence[str] = (),
) -> list[Path]:
    """Write a run for other programs, by any exporter that is installed.

    Args:
        format_name: the exporter, as a pipeline names it: "ply", "gltf", ...
        folder: to write into, created if need be; None: the run folder's exports.
        changes: `key=value`, settings of the exporter.
        without: kinds of initial points whose Gaussians are left out, for example "margin"; see
            `Run.kinds`.

    Returns:
        The files that were written.

    Raises:
        ExplainedError: no such exporter or kind, wrong settings, no folder, or what the exporter says.
    """
    from ..exporting import export as written
    from ..runs.results import EXPORTS
    from ..training.threads import one_torch_thread

    item = find_exporter(format_name, changes)
    place = Path(folder).expanduser() if folder else run.folder_or_refuse().path / EXPORTS
    with one_torch_thread():
        return written(run, item, place, without)


def find_exporter(format_name: str, changes: Sequence[str] = ()) -> Item:
    """What `export` is asked for, refused at once where it cannot be had.

    Raises:
        ExplainedError: no such exporter, or wrong settings.
    """
    from ..inspection.single_item import qualified, single_item

    point = SECTIONS["exporters"]
    offer = Plugins().find(point, format_name)
    return single_item(offer, [qualified(text, point.section) for text in changes])


def render(
    source: Run | GaussianModel,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Picture:
    """A camera as numpy arrays: rgb `[H, W, 3]` in [0, 1], depth and alpha `[H, W]`.

    Args:
        source: a run, which knows its background, or Gaussians alone.
        background: behind Gaussians alone, three numbers in [0, 1].
    """
    from ..runs.evaluation import clamped_render
    from ..runs.run import Run, as_arrays

    if isinstance(source, Run):
        return source.render(camera)
    return as_arrays(clamped_render(source, camera, background))


def results(folder: PathLike) -> dict[str, Any]:
    """What results.json of a run folder holds; empty before the run has ended.

    Raises:
        RunError: the folder is no run, or the file is damaged.
    """
    from ..runs.folder import RunFolder

    return RunFolder.existing(Path(folder).expanduser()).results()
