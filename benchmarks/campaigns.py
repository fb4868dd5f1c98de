"""Four campaigns of trainings: `python -m benchmarks.campaigns NAME`, which `make NAME` runs.

`methods`: every published method under one protocol. `parts`: StereoGS's parts with networks, one by one.
`results`: four pipelines on every data set. `skips`: time and PSNR of each shortcut of a pipeline.
All are resumable (`benchmarks.campaign`). Pictures of the test views are in `benchmarks/out/NAME`.
"""

from __future__ import annotations

import sys
from typing import Any

from benchmarks import (
    methods_page,
    methods_plan,
    parts_page,
    parts_plan,
    results_page,
    results_plan,
    skips_page,
    skips_plan,
)
from benchmarks.campaign import Campaign
from benchmarks.results_picture import draw_first_views
from benchmarks.trainings import SEEDS

METHODS = Campaign(
    name="methods",
    title="Published methods, all tables",
    data=[case.data for group in methods_plan.GROUPS for case in group.cases],
    plan=lambda plugins: methods_plan.planned_runs(
        methods_plan.METHODS, methods_plan.GROUPS, plugins
    ),
    page="methods.md",
    summary=methods_page.summary,
    tables=methods_page.tables,
)
PARTS = Campaign(
    name="parts",
    title="Parts of StereoGS, all tables",
    data=[case.data for table in parts_plan.TABLES for case in table.cases],
    plan=lambda plugins: parts_plan.planned_runs(parts_plan.TABLES, plugins),
    page="results.md",
    summary=parts_page.summary,
    tables=parts_page.tables,
)
RESULTS = Campaign(
    name="results",
    title="Every data set, all tables",
    data=[case.data for case in results_plan.CASES],
    plan=lambda plugins: results_plan.planned_runs(
        results_plan.CASES, results_plan.METHODS, SEEDS, plugins
    ),
    page="results.md",
    summary=results_page.summary,
    tables=results_page.tables,
    finish=draw_first_views,
)
SKIPS = Campaign(
    name="skips",
    title="Shortcuts of weightfree_fast",
    data=[case.data for case in skips_plan.CASES.values()],
    plan=skips_plan.planned_runs,
    tables=skips_page.tables,
    picture=skips_page.draw,
    target="bench-skips",
)
CAMPAIGNS: dict[str, Campaign[Any]] = {one.name: one for one in (METHODS, PARTS, RESULTS, SKIPS)}

if __name__ == "__main__":
    if sys.argv[1:2] not in [[name] for name in CAMPAIGNS]:
        sys.exit(f"name one of {', '.join(CAMPAIGNS)}")
    sys.exit(CAMPAIGNS[sys.argv.pop(1)].main(__doc__))
