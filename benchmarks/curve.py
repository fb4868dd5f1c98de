"""Draw error against seconds: `python -m benchmarks.curve`, after `stereogs bench benchmarks/curve.yaml`.

`make curve` runs both. A panel for each scene: PSNR of the test views against seconds since the start of the
run, from scores during the run and at its end.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.discovery import Plugins
from registry.system.files import replacing
from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import Plan
from stereogs.experiments.running.folder import AblationFolder
from stereogs.experiments.showing.against_time import Curves, curve, read_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HERE = Path(__file__).parent
MATRIX = HERE / "curve.yaml"
OUT = HERE / "out" / "curve"
PICTURE = OUT / "error_against_seconds.png"
METRIC = "psnr"
_TICKS = (5, 10, 20, 50, 100, 200)


def draw(plan: Plan, curves: Curves, path: Path) -> None:
    """Write the picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.4), dpi=110, layout="constrained")
    panels = figure.subplots(1, len(plan.scenes), squeeze=False)[0]
    for axes, scene in zip(panels, plan.scenes, strict=True):
        _panel(axes, plan, curves, scene)
    panels[0].set_ylabel("PSNR of test views, dB")
    panels[0].legend(fontsize=8, frameon=False)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _panel(axes: Axes, plan: Plan, curves: Curves, scene: str) -> None:
    for combination in plan.combinations:
        samples = curve(curves, combination, scene, METRIC)
        axes.errorbar(
            [sample.seconds for sample in samples],
            [sample.value for sample in samples],
            [sample.spread or 0 for sample in samples],
            marker=".",
            label=combination.choices[0].label if combination.choices[0] else None,
        )
    axes.set_xscale("log")
    axes.set_xticks(_TICKS, [str(tick) for tick in _TICKS])
    axes.minorticks_off()
    axes.set_title(f"{scene}, three photographs", fontsize=10)
    axes.set_xlabel("seconds of loading, first points and training")
    axes.grid(alpha=0.25)


def main() -> None:
    folder = AblationFolder(OUT)
    try:
        plan = plan_of(read_matrix(MATRIX), Plugins())
        results = {run: folder.results(run) for run in plan.runs}
        if missing := [run.name for run, found in results.items() if not found]:
            raise RunError(
                f"{len(missing)} of {len(results)} runs are missing",
                where=missing[0],
                fix=f"stereogs bench {MATRIX} --out {OUT}",
            )
        draw(plan, read_curves(results, folder), PICTURE)
        print(PICTURE)
    except ExplainedError as error:
        sys.exit(f"curve: {error}")


if __name__ == "__main__":
    main()
