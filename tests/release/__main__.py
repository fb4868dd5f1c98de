"""python -m tests.release: build both distributions and use them in an empty environment; minutes.

The environment is in build/release and is removed at the end; the distributions stay in dist/.
"""

from __future__ import annotations

import re
import shutil
import sys
import time
import venv
from pathlib import Path

from tests.release.distributions import DIST, ROOT, build, run

_FOLDER = ROOT / "build" / "release"
_PYTHON = _FOLDER / "empty" / "bin" / "python"
_WORK = _FOLDER / "work"
_EXAMPLES = sorted((ROOT / "docs" / "examples").glob("stereogs-*"))


def main() -> int:
    """Build, install and use; raise SystemExit at the first failure."""
    shutil.rmtree(_FOLDER, ignore_errors=True)
    engine, plugins = build()
    print(run(sys.executable, "-m", "twine", "check", "--strict", *sorted(DIST.iterdir())), end="")
    venv.create(_PYTHON.parent.parent, with_pip=True)
    _WORK.mkdir()
    before = _bytes()
    for wheel, use in ((engine, _use_engine), (plugins, _use_plugins)):
        started = time.monotonic()
        _install(wheel)
        seconds = time.monotonic() - started
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, installed in {seconds:.0f} s;"
              f" with all that it needs {(_bytes() - before) / 1e6:,.0f} MB", flush=True)  # fmt: skip
        use()
    for package in _EXAMPLES:
        _use_example(package)
    shutil.rmtree(_FOLDER)
    print(f"{2 + len(_EXAMPLES)} distributions work when they are installed from files")
    return 0


def _install(*what: str | Path) -> None:
    pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    run(_PYTHON, *pip, "--constraint", ROOT / "constraints.txt", *what)


def _bytes() -> int:
    files = _PYTHON.parent.parent.rglob("*")
    return sum(file.stat().st_size for file in files if file.is_file() and not file.is_symlink())


def _use_engine() -> None:
    """Run its README's example, and its self-test on the chosen device."""
    (example,) = re.findall(
        r"^```python\n(.*?)^```",
        (ROOT / "core_rasterizer" / "README.md").read_text("utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    same = "assert torch.equal(load_ply('scene.ply').means, means.detach())\n"
    test = (
        "from core_rasterizer import open_device\nfrom core_rasterizer.self_test import self_test\n"
    )
    run(_PYTHON, "-c", example + same + test + "self_test(open_device())", folder=_WORK)


def _use_plugins() -> None:
    program = _PYTHON.with_name("stereogs")
    print(run(program, "--version", folder=_WORK), end="")
    run(program, "plugins", "--check", folder=_WORK)
    scores = run(program, "demo", "--out", "demo", folder=_WORK)
    if not (_WORK / "demo" / "report.html").is_file():
        raise SystemExit(f"the demo wrote no report:\n{scores}")
    _install("pytest", "onnx")  # what the examples' tests need


def _use_example(package: Path) -> None:
    """Install a copy, so that no build files stay in the checkout, and run the tests in it."""
    copy = _WORK / package.name
    shutil.copytree(package, copy)
    _install(copy)
    for module in copy.glob("stereogs_*.py"):
        module.unlink()  # the tests import the installed one
    print(package.name, run(_PYTHON, "-m", "pytest", "-q", folder=copy).splitlines()[-1], flush=True)


if __name__ == "__main__":
    sys.exit(main())
