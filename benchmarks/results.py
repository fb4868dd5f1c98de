"""Four pipelines on every data set: `python -m benchmarks.results`, which `make results` runs.

Resumable, a record a training (`benchmarks.campaign`). A picture of the first test view of each row lies
in `benchmarks/out/results` afterwards.
"""

from __future__ import annotations

import sys

from benchmarks.campaign import Campaign
from benchmarks.results_page import BEGIN, END, page_text
from benchmarks.results_picture import draw_first_views
from benchmarks.results_plan import CASES, METHODS, SEEDS, make_measurements

RESULTS_CAMPAIGN = Campaign(
    name="results",
    data=[case.data for case in CASES],
    plan=lambda plugins: make_measurements(CASES, METHODS, SEEDS, plugins),
    page="results.md",
    marks=(BEGIN, END),
    text=page_text,
    look=draw_first_views,
)

if __name__ == "__main__":
    sys.exit(RESULTS_CAMPAIGN.main(__doc__))
