"""The two distributions: built from the checkout, and compared with what git tracks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
DIST = ROOT / "dist"
_ENGINE = "core_rasterizer"
_LINKED = ("pipelines", "protocols")
"""Folders of `stereogs_plugins` that are links to folders of these names in the root."""


def with_driver(engine: Path) -> str:
    """Return the engine's wheel, with its extra if this environment needs that for this processor."""
    try:
        metadata.distribution("intel-opencl-rt")
    except metadata.PackageNotFoundError:
        return str(engine)
    return f"{engine}[intel]"


def clean_environment() -> dict[str, str]:
    """Return an environment in which Python sees neither the checkout nor the user's data."""
    hidden = ("PYTHONPATH", "STEREOGS_DATA", "STEREOGS_MODELS", "STEREOGS_PLUGINS")
    return {name: value for name, value in os.environ.items() if name not in hidden}


def run(*command: str | Path, folder: Path = ROOT) -> str:
    """Return the output of a command in a clean environment; it must succeed."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=folder, env=clean_environment(), capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words)} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def build() -> list[Path]:
    """Build both into dist/, the sdist first and the wheel from it; return the wheels, the engine's first."""
    shutil.rmtree(DIST, ignore_errors=True)
    for source in (ROOT / _ENGINE, ROOT):
        run(sys.executable, "-m", "build", "--outdir", DIST, source)
    wheels = [*DIST.glob("stereogs_rasterizer-*.whl"), *DIST.glob("stereogs_plugins-*.whl")]
    for wheel, packages in zip(
        wheels, ([_ENGINE], ["registry", "stereogs", "stereogs_plugins"]), strict=True
    ):
        _compare(wheel, packages)
    return wheels


def _compare(wheel: Path, packages: list[str]) -> None:
    """Refuse a wheel whose files are not those of its packages."""
    tracked = run("git", "ls-files", *packages, *_LINKED).splitlines()
    expected = {_installed_name(file) for file in tracked} - {""}
    expected = {file for file in expected if file.split("/")[0] in packages}
    names = zipfile.ZipFile(wheel).namelist()
    found = {name for name in names if ".dist-info/" not in name}
    if found != expected:
        raise SystemExit(f"{wheel.name}: missing or too many: {sorted(found ^ expected)}")
    if not any(name.endswith("licenses/LICENSE") for name in names):
        raise SystemExit(f"{wheel.name} has no licence file")


def _installed_name(file: str) -> str:
    """The name of a tracked file in a wheel; "" if it stays out."""
    folder = file.partition("/")[0]
    if folder in _LINKED:
        return f"stereogs_plugins/{file}" if file.endswith(".yaml") else ""
    outside = {f"stereogs_plugins/{link}" for link in _LINKED}
    outside |= {f"{_ENGINE}/{other}" for other in ("pyproject.toml", "README.md", "LICENSE")}
    return "" if file in outside else file
