"""python -m tests.release.pythons [TESTS...]: tests against the built wheels, on each Python that is found.

Environments stay in build/pythons, so that a second run installs only what is new.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.release.distributions import ROOT, build, clean_environment, run, with_driver

_OLDEST, _NEWEST = 11, 20
_FOLDER = ROOT / "build" / "pythons"
_TESTS = ("tests/registry", "tests/stereogs", "tests/core_rasterizer/test_rasterize.py")
"""Where Pythons differ: annotations, dataclasses, argparse, processes, files; and one use of the engine."""


def main() -> int:
    """Run the tests on each; return 1 if one fails."""
    wheels = build()
    failed = []
    for version, python in interpreters().items():
        environment = _FOLDER / "environments" / version
        _install(python, environment, wheels)
        print(f"Python {version}: testing", flush=True)
        command = [environment / "bin" / "python", "-m", "pytest", *(sys.argv[1:] or _TESTS)]
        options = ["--numprocesses", "2", "--dist", "worksteal"]
        done = subprocess.run(
            [*command, *options], cwd=_suite(environment), env=clean_environment()
        )
        failed += [version] if done.returncode else []
    print(f"failed on {', '.join(failed)}" if failed else "passed on all")
    return 1 if failed else 0


def interpreters() -> dict[str, Path]:
    """The newest of each minor version from pyenv and PATH that this project supports, by its version."""
    found = {}
    for minor in range(_OLDEST, _NEWEST):
        on_path = shutil.which(f"python3.{minor}")
        candidates = [Path(on_path)] if on_path else []
        candidates += Path("~/.pyenv/versions").expanduser().glob(f"3.{minor}.*/bin/python")
        versions = {version: python for python in candidates if (version := _version(python))}
        if versions:
            newest = max(versions, key=lambda version: int(version.split(".")[2]))
            found[newest] = versions[newest]
    return found


def _version(python: Path) -> str:
    """Such as 3.12.1; "" for previews and for a command that does not start."""
    code = "import platform; print(platform.python_version())"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True)
    return text if re.fullmatch(r"[\d.]+", text := done.stdout.strip()) else ""


def _install(python: Path, environment: Path, wheels: list[Path]) -> None:
    """Install the wheels and what their tests need."""
    run(python, "-m", "venv", environment)
    engine, plugins = wheels
    pip = (environment / "bin" / "python", "-m", "pip", "install", "--quiet")
    run(
        *pip,
        "--constraint",
        ROOT / "constraints.txt",
        with_driver(engine),
        f"{plugins}[dev,plot,video]",
    )
    run(*pip, "--force-reinstall", "--no-deps", *wheels)  # of an unchanged version, but rebuilt


def _suite(environment: Path) -> Path:
    """A copy of the checkout, in which the packages are links to the installed ones."""
    suite = _FOLDER / "suites" / environment.name
    shutil.rmtree(suite, ignore_errors=True)
    (site,) = environment.glob("lib/python*/site-packages")
    packages = ("core_rasterizer", "registry", "stereogs", "stereogs_plugins")
    for name in run("git", "ls-files").splitlines():
        if name.split("/")[0] not in packages:
            (suite / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, suite / name)
    for package in packages:
        (suite / package).symlink_to(site / package)
    return suite


if __name__ == "__main__":
    sys.exit(main())
