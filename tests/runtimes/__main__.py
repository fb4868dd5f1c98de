"""python -m tests.runtimes [NAME...]: the engine and matching tests on each OpenCL runtime that can be had.

Each runtime is fetched into build/runtimes the first time. One that cannot be fetched is reported and
skipped. Exit status 1 if a test fails. `--write-docs` rewrites the table in docs/numerics.md.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import Counter

from tests.runtimes.catalog import RUNTIMES, Runtime
from tests.runtimes.fetching import FOLDER, ROOT, Unavailable

_TESTS = "tests/core_rasterizer"
_OPTIONS = (
    "-p",
    "no:cacheprovider",
    "--timeout",
    "900",
    "--numprocesses",
    "2",
    "--dist",
    "worksteal",
)
_DOCS = ROOT / "docs" / "numerics.md"
_BEGIN, _END = "<!-- runtimes: begin -->\n", "<!-- runtimes: end -->\n"
_HEAD = """\
| runtime | stands for | kernels | passed | skipped | failed | colour | depth | gradient |
|---|---|---|---|---|---|---|---|---|
"""


def main() -> int:
    """Run the tests; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a runtime's name")
    parser.add_argument("--write-docs", action="store_true", help="rewrite the table in docs")
    arguments = parser.parse_args()
    rows, failed = [], False
    for runtime in RUNTIMES:
        if arguments.names and not any(n.lower() in runtime.name.lower() for n in arguments.names):
            continue
        try:
            environment = runtime.environment()
        except Unavailable as reason:
            print(f"{runtime.name}: skipped, it cannot be fetched: {reason}", flush=True)
            continue
        print(f"{runtime.name}: testing", flush=True)
        counts, passed = tested(runtime, environment)
        failed |= not passed
        new = [
            row(runtime, variant, counts[variant], errors(variant, environment))
            for variant in runtime.variants
        ]
        print("".join(new), flush=True)
        rows += new
    if arguments.write_docs and rows:
        text = _DOCS.read_text("utf-8")
        before, rest = text.split(_BEGIN)
        _DOCS.write_text(
            before + _BEGIN + _HEAD + "".join(rows) + _END + rest.split(_END)[1], "utf-8"
        )
    return 1 if failed else 0


def tested(runtime: Runtime, environment: dict[str, str]) -> tuple[dict[str, Counter[str]], bool]:
    """Run the tests on one runtime.

    Returns:
        How many tests of each variant passed, were skipped and failed; and whether all went well.
    """
    report = FOLDER / f"{runtime.name.replace(' ', '_')}.xml"
    kernels = " or ".join(f"{variant}_kernels" for variant in runtime.variants)
    command = [sys.executable, "-m", "pytest", _TESTS, "-k", kernels, f"--junitxml={report}"]
    result = subprocess.run([*command, *_OPTIONS], cwd=ROOT, env=environment)
    counts: dict[str, Counter[str]] = {variant: Counter[str]() for variant in runtime.variants}
    for case in ET.parse(report).iter("testcase"):
        for variant in runtime.variants:
            if f"{variant}_kernels" in case.get("name", ""):
                counts[variant][_outcome(case)] += 1
    return counts, result.returncode == 0


def _outcome(case: ET.Element) -> str:
    if case.find("failure") is not None or case.find("error") is not None:
        return "failed"
    return "passed" if case.find("skipped") is None else "skipped"


def errors(variant: str, environment: dict[str, str]) -> dict[str, float]:
    """Differences between the device and the reference in double precision, by name."""
    code = (
        "import json\nfrom core_rasterizer import open_device\n"
        "from core_rasterizer.self_test import self_test\n"
        f"verdict = self_test(open_device().as_variant({variant!r}))\n"
        "print(json.dumps(vars(verdict)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    if result.returncode:
        raise SystemExit(result.stderr)
    found: dict[str, float] = json.loads(result.stdout.splitlines()[-1])
    return found


def row(runtime: Runtime, variant: str, counts: Counter[str], found: dict[str, float]) -> str:
    """One line of the table."""
    cells = [runtime.name, runtime.stands_for, variant.upper()]
    cells += [str(counts[outcome]) for outcome in ("passed", "skipped", "failed")]
    cells += [f"{found[name]:.1e}" for name in ("image_error", "depth_error", "gradient_error")]
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    sys.exit(main())
