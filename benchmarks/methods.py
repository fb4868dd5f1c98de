"""Every method under one protocol: `python -m benchmarks.methods`, which `make methods` runs.

Resumable, a record a training (`benchmarks.campaign`). Pictures of the test views lie in
`benchmarks/out/methods`.
"""

from __future__ import annotations

import sys

from benchmarks.campaign import Campaign
from benchmarks.methods_page import BEGIN, END, page_text
from benchmarks.methods_plan import GROUPS, METHODS, planned_runs

METHODS_CAMPAIGN = Campaign(
    name="methods",
    data=[case.data for group in GROUPS for case in group.cases],
    plan=lambda plugins: planned_runs(METHODS, GROUPS, plugins),
    page="methods.md",
    marks=(BEGIN, END),
    text=page_text,
)

if __name__ == "__main__":
    sys.exit(METHODS_CAMPAIGN.main(__doc__))
