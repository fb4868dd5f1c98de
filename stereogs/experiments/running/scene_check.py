"""Load every scene of a plan once, before anything is trained."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from core_rasterizer import Device
from core_rasterizer.errors import ExplainedError
from registry import PluginError, RunError
from registry.calls.process_state import one_torch_thread
from registry.discovery import SCENE, Plugins
from registry.messages.suggestions import counted
from registry.pipeline.parts import build_part, load_scene

from ..planning.plan import PlannedRun


def check_scenes(runs: Sequence[PlannedRun], device: Device, plugins: Plugins) -> None:
    """Load the scene of each run, equal ones once. What loaders cache, the trainings use again.

    Raises:
        RunError: scenes cannot be loaded; contains the first error.
    """
    distinct: dict[tuple[str, str], PlannedRun] = {}
    for run in runs:
        item = run.pipeline.one(SCENE.section)
        distinct.setdefault((item.offer.name, item.settings.model_dump_json()), run)
    failures: list[tuple[str, ExplainedError]] = []
    for run in distinct.values():
        try:
            with one_torch_thread():
                load_scene(build_part(run.pipeline.one(SCENE.section), run.seed, device))
        except ExplainedError as error:
            failures.append((run.scene, error))
    if not failures:
        return
    scene, first = failures[0]
    fix = first.fix
    with suppress(PluginError):
        plugins.find(SCENE, scene)
        fix = f"{fix}; the loader of this name is written {{use: {scene}}}"
    raise RunError(
        f"{len(failures)} of {counted(len(distinct), 'scene')} cannot be loaded, so nothing is trained; "
        f"the first is {scene!r}: {first.what}",
        where=first.where,
        fix=fix,
    ) from first
