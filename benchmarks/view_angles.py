"""Angles from each test view to the training views: `python -m benchmarks.view_angles`.

Writes `benchmarks/records/view_angles.json`, which the tables of `make results` read to separate interpolated
from extrapolated views. Needs the data sets, and no training.
"""

from __future__ import annotations

import json

from benchmarks.records import RECORDS
from benchmarks.results_plan import CASES, METHODS, planned_runs
from benchmarks.trainings import Case, check_data
from registry.discovery import Plugins
from registry.system.files import write_text
from registry.toolkit.views import subject_of, view_angles
from registry.toolkit.views.viewing_angles import ViewAngles
from stereogs.session import load_scene

FILE = RECORDS / "view_angles.json"


def measured(case: Case) -> dict[str, ViewAngles]:
    """Return the angles of each test view by its name; loads the scene."""
    (run, *_) = planned_runs([case], METHODS, [0], Plugins())  # one scene for all methods
    scene = load_scene(run.pipeline)
    training = [view.camera for view in scene.train]
    points = None if scene.points is None else scene.points.positions
    return {
        view.name: view_angles(view.camera, training, subject_of(view.camera, scene.bounds, points))
        for view in scene.test
    }


def recorded() -> dict[str, dict[str, ViewAngles]]:
    """Return the angles of each test view by the case's name, such as "llff_fern-3"."""
    found = json.loads(FILE.read_text("utf-8"))
    return {
        case: {view: ViewAngles(*angles) for view, angles in views.items()}
        for case, views in found.items()
    }


if __name__ == "__main__":
    check_data(case.data for case in CASES)
    lines = []
    for case in CASES:
        views = {name: [round(x, 2) for x in angles] for name, angles in measured(case).items()}
        lines.append(f"{json.dumps(f'{case.data}-{case.views}')}: {json.dumps(views)}")
        print(f"{case.data}-{case.views}: {len(views)} test views")
    write_text(FILE, "{\n" + ",\n".join(lines) + "\n}\n")
