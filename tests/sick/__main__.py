"""python -m tests.sick: run every case by default, with --check-plugins, and in `registry.testing.check`."""

from __future__ import annotations

import logging
import sys
from collections import Counter

from core_rasterizer import open_device
from tests.sick.cases import all_cases
from tests.sick.trial import found_by_check, verdict


def main() -> int:
    """Print the table; return 1 if a case changes numbers and none of the three finds it."""
    logging.getLogger("stereogs").addHandler(logging.NullHandler())
    logging.getLogger("stereogs").propagate = False
    device, wanted = open_device(), " ".join(sys.argv[1:])
    counts, unnoticed = Counter[tuple[str, str]](), 0
    print(f"{'default':9} {'checked':9} {'check':6} case")
    for case in all_cases():
        if wanted not in case.name:
            continue
        default, checked = (verdict(case, device, checked=flag) for flag in (False, True))
        found = "found" if found_by_check(case, device) else "-"
        counts.update([("default", default), ("checked", checked), ("check", found)])
        unnoticed += (default, checked, found) == ("silent", "silent", "-")
        print(f"{default:9} {checked:9} {found:6} {case.name}", flush=True)
    for (column, what), count in sorted(counts.items()):
        print(f"{column}: {count} {what}")
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main())
