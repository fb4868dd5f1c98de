"""python -m tests.release: build both distributions and use them in an empty environment; minutes.

The environment is in a temporary folder outside of the checkout; the distributions stay in dist/.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import time
import venv
from pathlib import Path

from tests.release.distributions import DIST, ROOT, build, run, with_driver

_EXAMPLES = sorted((ROOT / "docs" / "examples").glob("stereogs-*"))


def main() -> int:
    """Build, install and use; raise SystemExit at the first failure."""
    wheels = build()
    print(run(sys.executable, "-m", "twine", "check", "--strict", *sorted(DIST.iterdir())), end="")
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        Installed(Path(folder)).use(*wheels)
    print(f"{len(wheels) + len(_EXAMPLES)} packages work when they are installed from files")
    return 0


class Installed:
    """An environment that is empty at first."""

    def __init__(self, folder: Path) -> None:
        self._environment, self._work = folder / "environment", folder / "work"
        venv.create(self._environment, with_pip=True)
        self._work.mkdir()
        self._python = self._environment / "bin" / "python"
        self._at_first = self._bytes()

    def use(self, engine: Path, plugins: Path) -> None:
        """Install and use the engine, then the plugins, then the example packages."""
        self._measure(engine)
        self._install(with_driver(engine))
        self._use_engine()
        self._measure(plugins)
        self._use_plugins()
        self._use_examples()

    def _measure(self, wheel: Path) -> None:
        started = time.monotonic()
        self._install(wheel)
        seconds, size = time.monotonic() - started, self._bytes() - self._at_first
        print(
            f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, installed in {seconds:.0f} s; "
            f"with all that it needs {size / 1e6:,.0f} MB",
            flush=True,
        )

    def _install(self, *what: str | Path) -> None:
        pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        run(self._python, *pip, "--constraint", ROOT / "constraints.txt", *what)

    def _bytes(self) -> int:
        files = self._environment.rglob("*")
        return sum(
            file.stat().st_size for file in files if file.is_file() and not file.is_symlink()
        )

    def _use_engine(self) -> None:
        """Run the example of its README, in which a PLY file is written and read."""
        text = (ROOT / "core_rasterizer" / "README.md").read_text("utf-8")
        (example,) = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        same = "assert torch.equal(load_ply('scene.ply').means, means.detach())"
        run(self._python, "-c", example + same, folder=self._work)

    def _use_plugins(self) -> None:
        program = self._environment / "bin" / "stereogs"
        print(run(program, "--version", folder=self._work), end="")
        run(program, "plugins", "--check", folder=self._work)
        output = run(program, "demo", "--out", "demo", folder=self._work)
        if not (self._work / "demo" / "report.html").is_file():
            raise SystemExit(f"the demo wrote no report:\n{output}")

    def _use_examples(self) -> None:
        """Install copies, so that no build files stay in the checkout, and run their tests."""
        copies = [self._work / package.name for package in _EXAMPLES]
        for package, copy in zip(_EXAMPLES, copies, strict=True):
            shutil.copytree(package, copy)
        self._install("pytest", "onnx", *copies)
        for module in self._work.glob("*/stereogs_*.py"):
            module.unlink()  # the tests import the installed one
        print(run(self._python, "-m", "pytest", "-q", folder=self._work), end="", flush=True)


if __name__ == "__main__":
    sys.exit(main())
