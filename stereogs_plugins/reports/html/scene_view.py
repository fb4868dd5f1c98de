"""The run's Gaussians in 3D: what the page holds, or has beside it, for the viewer."""

from __future__ import annotations

import base64
import gzip
import json
import math
from dataclasses import dataclass, replace
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from registry.system import write_text
from registry.toolkit import web_page

from .spz import spz

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from core_rasterizer import Gaussians
    from registry import Scene, View

BESIDE = "report_files"
"""The folder for what does not lie in the page."""
_VIEWER_FILE, _DATA_FILE = "viewer.js", "scene.js"
_VIEWER = files(__package__) / "viewer"
_NEAR_ALL = 90.0
"""Per cent of the Gaussians that lie within the viewer's unit cube, ten wide."""
_RADIUS = 5.0
_LICENSES = "Licences of the 3D viewer (Spark, three.js, fflate)"


@dataclass(frozen=True)
class SceneView:
    """A part of the page.

    Args:
        content: HTML.
        files: that were written beside the page.
    """

    content: str
    files: tuple[Path, ...] = ()


def scene_view(
    gaussians: Gaussians,
    scene: Scene,
    training: dict[str, Any],
    folder: Path,
    *,
    beside: bool,
    largest_mb: float,
) -> SceneView:
    """A view that is turned with mouse, keys or fingers and starts at the first test view.

    Args:
        gaussians: at least one.
        training: the pipeline's training settings: `dilation` and `compensate_dilation` are used.
        folder: the run's, for files beside the page.
        beside: put the viewer and the Gaussians into files beside the page, not into it.
        largest_mb: of a page's Gaussians; larger ones are not held, and a note says so.
    """
    center, factor = _frame(gaussians)
    packed = spz(_framed(gaussians, center, factor))
    megabytes = len(packed) / 1e6
    if not beside and megabytes > largest_mb:
        text = (
            f"The Gaussians take {megabytes:.0f} MB, more than the {largest_mb:g} MB that this page "
            f"may hold. `stereogs report {folder.name} --beside` puts them into files beside it."
        )
        return SceneView(web_page.note(text))
    setup = _setup(scene, training, center, factor)
    written: tuple[Path, ...] = ()
    if beside:
        written = _write_beside(folder / BESIDE, packed)
        held = "".join(f'<script src="{BESIDE}/{file.name}"></script>' for file in written)
    else:
        held = _held("viewer-data", gzip.compress(_read("viewer.js").encode(), 4, mtime=0))
        held += _held("scene-data", packed)
    names = [f"{kind} {view.name}" for kind, view in _views(scene)]
    shape = f"{scene.train[0].camera.width} / {scene.train[0].camera.height}"
    return SceneView(
        '<div class="scene-view">'
        f'<div class="canvas" style="aspect-ratio:{shape};width:calc(80vh * {shape})">'
        "The 3D view needs JavaScript.</div>"
        f"<label>as seen by <select disabled>{''.join(map(_option, names))}</select></label> "
        + web_page.note("Drag to turn, scroll or pinch to come nearer, two fingers to move.")
        + "</div>"
        + f'<script type="application/json" id="scene-setup">{_json(setup)}</script>'
        + f"{held}<script>{_read('start.js')}</script>"
        + web_page.folded(_LICENSES, web_page.verbatim(_read("LICENSES.txt"))),
        written,
    )


def _frame(gaussians: Gaussians) -> tuple[NDArray[np.float64], float]:
    """Where the scene is put in the viewer: SPZ keeps sizes around 1 best, whatever the world's unit."""
    means = gaussians.means.double().numpy()
    center = np.median(means, axis=0)
    radius = float(np.percentile(np.abs(means - center), _NEAR_ALL))
    return center, _RADIUS / max(radius, 1e-9)


def _framed(gaussians: Gaussians, center: NDArray[np.float64], factor: float) -> Gaussians:
    import torch

    return replace(
        gaussians,
        means=(gaussians.means.double() - torch.from_numpy(center)) * factor,
        log_scales=gaussians.log_scales + math.log(factor),
    )


def _setup(
    scene: Scene, training: dict[str, Any], center: NDArray[np.float64], factor: float
) -> dict[str, Any]:
    """What `showScene` in viewer/scene_view.js wants to know."""
    rotations = [view.camera.world_to_camera.numpy()[:3, :3] for view in scene.train]
    return {
        "up": [-float(value) for value in np.mean(rotations, axis=0)[1]],
        "target": [0.0, 0.0, 0.0],
        "background": list(scene.background),
        "dilation": training.get("dilation", 0.3),
        "compensate": training.get("compensate_dilation", False),
        "views": [_pose(view, center, factor) for _, view in _views(scene)],
    }


def _views(scene: Scene) -> Sequence[tuple[str, View]]:
    return [("test", view) for view in scene.test] + [("train", view) for view in scene.train]


def _pose(view: View, center: NDArray[np.float64], factor: float) -> dict[str, Any]:
    camera = view.camera
    # OpenGL's cameras look along -z with y up, OpenCV's along z with y down.
    pose = camera.camera_to_world.numpy() @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (pose[:3, 3] - center) * factor
    fov = math.degrees(2 * math.atan(camera.height / (2 * camera.fy)))
    return {"pose": pose.flatten().tolist(), "fov": fov}


def remove_beside(folder: Path) -> None:
    """Take away what an earlier report put beside its page, and nothing else.

    Args:
        folder: the run's.
    """
    beside = folder / BESIDE
    for name in (_VIEWER_FILE, _DATA_FILE):
        (beside / name).unlink(missing_ok=True)
    if beside.is_dir() and not any(beside.iterdir()):
        beside.rmdir()


def _write_beside(folder: Path, packed: bytes) -> tuple[Path, ...]:
    """As scripts: a page from a disk may load nothing else."""
    folder.mkdir(exist_ok=True)
    viewer, data = folder / _VIEWER_FILE, folder / _DATA_FILE
    write_text(viewer, _read("viewer.js"))
    write_text(data, f'globalThis["scene-data"]="{_base64(packed)}";\n')
    return viewer, data


def _held(name: str, data: bytes) -> str:
    return f'<script type="text/plain" id="{name}">{_base64(data)}</script>'


def _option(name: str) -> str:
    return f"<option>{escape(name)}</option>"


def _json(value: Any) -> str:
    return json.dumps(value).replace("<", "\\u003c")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _read(name: str) -> str:
    return (_VIEWER / name).read_text("utf-8")
