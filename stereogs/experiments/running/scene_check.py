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
from registry.pipeline.parts import Parts, load_scene

from ..planning.plan import PlannedRun


def check_scenes(runs: Sequence[PlannedRun], device: Device, plugins: Plugins) -> list[str]:
    """Load the scene of each run, equal ones once. What loaders cache, the trainings use again.

    Returns:
        A warning for each scene without test views.

    Raises:
        RunError: scenes cannot be loaded; contains the first error.
    """
    distinct: dict[tuple[str, str], PlannedRun] = {}
    for run in runs:
        item = run.pipeline.one(SCENE.section)
        distinct.setdefault((item.offer.name, item.settings.model_dump_json()), run)
    failures: list[tuple[str, ExplainedError]] = []
    without_test = []
    for run in distinct.values():
        try:
            with one_torch_thread():
                scene = load_scene(Parts(run.pipeline, device).one(SCENE.section))
        except ExplainedError as error:
            failures.append((run.scene, error))
            continue
        if not scene.test:
            without_test.append(
                f"the scene {run.scene} has no test views, so its runs have no scores of new views; "
                "--set scene.test_every=8 holds out every 8th photograph"
            )
    if not failures:
        return without_test
    label, first = failures[0]
    fix = first.fix
    with suppress(PluginError):
        plugins.find(SCENE, label)
        fix = f"{fix}; the loader of this name is written {{use: {label}}}"
    raise RunError(
        f"{len(failures)} of {counted(len(distinct), 'scene')} cannot be loaded, so nothing is trained; "
        f"the first is {label!r}: {first.what}",
        where=first.where,
        fix=fix,
    ) from first
