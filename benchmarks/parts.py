"""StereoGS's parts with networks, one by one: `python -m benchmarks.parts`, which `make parts` runs.

Resumable, a record a training (`benchmarks.campaign`); trainings that begin alike share their beginning.
Pictures of the test views lie in `benchmarks/out/parts`.
"""

from __future__ import annotations

import sys

from benchmarks.campaign import Campaign
from benchmarks.parts_page import BEGIN, END, page_text
from benchmarks.parts_plan import TABLES, planned_runs, together

PARTS_CAMPAIGN = Campaign(
    name="parts",
    data=[case.data for table in TABLES for case in table.cases],
    plan=lambda plugins: planned_runs(TABLES, plugins),
    page="parts_measured.md",
    marks=(BEGIN, END),
    text=page_text,
    together=together,
)

if __name__ == "__main__":
    sys.exit(PARTS_CAMPAIGN.main(__doc__))
