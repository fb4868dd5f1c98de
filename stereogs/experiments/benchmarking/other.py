"""The trial of another program: write the training views, run its command, score what it leaves.

The program never gets test photographs. It gets the cameras of the test views only after its training, and
only if it renders them itself.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from core_rasterizer import SH_C0, Engine, Gaussians, Rendering, load_ply
from registry import PointCloud, RunError, Scene, View
from registry.calls.process_state import one_torch_thread
from registry.pipeline.parts import Parts
from registry.pipeline.pipeline import Pipeline
from registry.runs.evaluation import Scores, clamped_render
from registry.runs.options import RunOptions
from registry.runs.preparation import load, prepare, running
from registry.toolkit.photos import open_8_bit
from registry.training.initial_model import new_model
from registry.training.placed import PlacedGaussians

from ...protocol_scene import write_scene
from .scoring import about, score, scores_of

_POLL_SECONDS = 0.05
_LAST_LINES = 5
_FLAT = "its Gaussians show the training photographs no better than images of one colour"


@dataclass(frozen=True)
class Ran:
    """How a command ran: wall-clock start, CPU seconds, and the peak memory of its main process if known."""

    started: float
    seconds: float
    cpu_seconds: float
    peak_memory_mb: float | None


def run_program(
    asked: Mapping[str, Any], pipeline: Pipeline, folder: Path, device: str | None
) -> dict[str, Any]:
    """Train with the program, and return its record.

    Raises:
        RunError: a command fails, hangs or leaves no output; an output is damaged or has another size; or the
            Gaussians are in other coordinates than the cameras.
    """
    program = asked["program"]
    with running(RunOptions(device=device)) as options:
        initial = prepare(load(pipeline, options), options)
    scene, engine = initial.scene, new_engine(initial.parts)
    model = new_model(initial.gaussians, pipeline.training, engine)
    points = _points(PlacedGaussians(model, initial.framed.frame).gaussians())
    write_scene(given_views(scene, points, program["repeat_first"]), program["layout"], folder)
    out = folder / "out"
    out.mkdir()
    places = {"data": folder / program["layout"], "out": out, "seed": asked["seed"]}
    version = _printed(program["version"], out)
    log = folder / "train.log"
    ran = run_command(program["train"], places, out, log, program["timeout"])
    if program["gaussians"] is not None:
        states = _states(out, program["gaussians"], ran.started)
        final = states[-1]
        refuse_moved_frame(final[1], scene, pipeline, engine)
        rows = {s: score(g, scene, initial.parts, engine) for s, g in states}
        end, count = {"seconds": final[0], **rows[final[0]]}, len(final[1].means)
        budgets = {
            f"{b:g}": {"seconds": last, **rows[last]}
            for b in asked["budgets"]
            if (last := max((s for s in rows if s <= b), default=None)) is not None
        }
    else:
        end = {"seconds": ran.seconds, **_rendered(program, scene, initial.parts, folder, places)}
        count = None
        budgets = {f"{b:g}": end for b in asked["budgets"] if b >= ran.seconds}
    found = about(pipeline, initial.parts, scene, engine)
    found["software"] = {"program": version}
    return {
        **found,
        "budgets": budgets,
        "end": end,
        "gaussians": count,
        "hash": None,
        "cpu_seconds": ran.cpu_seconds,
        "peak_memory_mb": ran.peak_memory_mb,
        "takes_seed": "{seed}" in program["train"],
    }


def new_engine(parts: Parts) -> Engine:
    """Return an engine on the device of the parts."""
    from core_rasterizer import Device, OpenCLEngine

    return OpenCLEngine(parts.device) if isinstance(parts.device, Device) else parts.device


def given_views(scene: Scene, points: PointCloud, repeat_first: bool) -> Scene:
    """Return the scene that a program may see: training views and points; no test view."""
    first = (replace(scene.train[0], name="0000_first"),) if repeat_first else ()
    return replace(scene, train=(*first, *scene.train), test=(), points=points)


def _points(gaussians: Gaussians) -> PointCloud:
    """Return centres and colours of Gaussians."""
    colors = (gaussians.sh[:, 0] * SH_C0 + 0.5).clamp(0, 1)
    return PointCloud(gaussians.means.double(), colors.float())


def run_command(
    command: str, places: Mapping[str, Any], folder: Path, log: Path, timeout: float
) -> Ran:
    """Run a command in a folder to its end; it and its children are killed after `timeout` seconds.

    Raises:
        RunError: it cannot be started, does not end, or its exit status is not 0.
    """
    words = _words(command, places)
    before, started, peak = _children_seconds(), time.time(), None
    with log.open("wb") as output:
        try:
            process = subprocess.Popen(
                words,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise RunError(
                f"the program cannot be started: {error.strerror or error}",
                where=shlex.join(words),
                fix="install it, or correct its path in the program's file",
            ) from error
    try:
        while process.poll() is None:
            peak = _peak_mb(process.pid) or peak
            if time.time() - started > timeout:
                raise RunError(
                    f"the program did not end within {timeout:g} s; is its viewer open?",
                    where=str(log),
                    fix="disable its viewer, or raise `timeout` in the program's file",
                )
            time.sleep(_POLL_SECONDS)
    finally:
        if process.poll() is None:
            _kill(process)
    if process.returncode:
        last = log.read_text("utf-8", errors="replace").splitlines()[-_LAST_LINES:]
        raise RunError(
            "\n".join([f"the program ended with status {process.returncode}:", *last]),
            where=str(log),
            fix="read the log, correct the commands in the program's file, and run it again",
        )
    return Ran(started, time.time() - started, _children_seconds() - before, peak)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        process.kill()
    else:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _words(command: str, places: Mapping[str, Any]) -> list[str]:
    names = "|".join(places)

    def filled(word: str) -> str:
        return re.sub(rf"\{{({names})\}}", lambda found: str(places[found[1]]), word)

    return [filled(word) for word in shlex.split(command)]


def _children_seconds() -> float:
    times = os.times()
    return times.children_user + times.children_system


def _peak_mb(process: int) -> float | None:
    """Return the peak memory of a process so far; None after its end, or if the system does not tell."""
    try:
        text = Path(f"/proc/{process}/status").read_text("ascii", errors="replace")
    except OSError:
        return None
    found = re.search(r"^VmHWM:\s+(\d+) kB$", text, re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else None


def _printed(command: str, folder: Path) -> str:
    """Return what the command for the version prints; one program is never mixed with another version."""
    log = folder.with_name("version.log")
    run_command(command, {}, folder, log, timeout=60)
    return log.read_text("utf-8", errors="replace").strip()[:500]


def _states(out: Path, pattern: str, started: float) -> list[tuple[float, Gaussians]]:
    """Return the Gaussians of each file by the seconds at which it was written, rising.

    Raises:
        RunError: there are none; the exit status of the program was 0.
        PlyError: a file is damaged.
    """
    files = {file.stat().st_mtime - started: file for file in out.glob(pattern) if file.is_file()}
    if not files:
        raise RunError(
            f"the program ended with status 0 and left no file that matches {pattern!r}",
            where=str(out),
            fix=f"read {out.with_name('train.log')}",
        )
    return [(seconds, load_ply(files[seconds])) for seconds in sorted(files)]


@one_torch_thread()
def refuse_moved_frame(
    gaussians: Gaussians, scene: Scene, pipeline: Pipeline, engine: Engine
) -> None:
    """Refuse Gaussians that show the training views worse than images of one colour each.

    Raises:
        RunError: they do; a program moved the world, or trained nothing.
    """
    model = new_model(gaussians, pipeline.training, engine)
    errors = flat = 0.0
    for view in scene.train:
        rendered = clamped_render(model, view.camera, scene.background).rgb
        errors += float((rendered - view.image).square().mean())
        flat += float((view.image - view.image.mean((0, 1))).square().mean())
    if errors >= flat:
        raise RunError(
            _FLAT,
            where=pipeline.name,
            fix="does the program move the world's origin, axes or unit? Disable that in its command",
        )


def _rendered(
    program: Mapping[str, Any],
    scene: Scene,
    parts: Parts,
    folder: Path,
    places: Mapping[str, Any],
) -> dict[str, Any]:
    """Let the program render the test cameras, and score its images."""
    black = [replace(view, image=torch.zeros_like(view.image)) for view in scene.test]
    cameras, renders = folder / "cameras", folder / "renders"
    for place in (cameras, renders):
        place.mkdir()
    write_scene(replace(scene, train=tuple(black), test=(), points=None), "transforms", cameras)
    more = {"cameras": cameras / "transforms", "renders": renders}
    log = folder / "render.log"
    run_command(program["render"], {**places, **more}, folder / "out", log, program["timeout"])
    images = [_image(renders / f"{view.name}.png", view) for view in scene.test]
    return scores_of(_scored(images, scene, parts), parts.pipeline)


def _image(file: Path, view: View) -> torch.Tensor:
    """Read a render.

    Raises:
        RunError: it is missing, or of another size.
    """
    if not file.is_file():
        what = "the program ended with status 0 and left no render of this view"
        raise RunError(what, where=str(file), fix="write one PNG for each camera, by its name")
    with open_8_bit(file, "the render") as found:
        size, wanted = found.size, (view.camera.width, view.camera.height)
        if size != wanted:
            raise RunError(
                f"the render has {size[0]}x{size[1]} pixels, not {wanted[0]}x{wanted[1]}",
                where=str(file),
                fix="render at the size of the camera",
            )
        pixels: Image.Image = found.convert("RGB")
        return torch.from_numpy(np.array(pixels, np.float32) / 255)


@one_torch_thread()
def _scored(images: Sequence[torch.Tensor], scene: Scene, parts: Parts) -> Scores:
    from registry import Unavailable

    scores = Scores({})
    for image, view in zip(images, scene.test, strict=True):
        nothing = torch.zeros(image.shape[:2])
        row: dict[str, float | None] = {}
        for part in parts["metrics"]:
            found = part.call(Rendering(image, nothing, nothing), view, scene)
            if isinstance(found, Unavailable):
                scores.unavailable[part.item.name] = found.reason
            row[part.item.name] = None if isinstance(found, Unavailable) else found
        scores.views[view.name] = row
    return scores
