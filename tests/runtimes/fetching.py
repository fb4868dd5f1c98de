"""Download packages of Debian and PyPI and unpack them into folders of their own; nothing is installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
FOLDER = ROOT / "build" / "runtimes"
_SECONDS = 300
"""For each command; an unreachable mirror is given up earlier."""


class Unavailable(Exception):
    """A package cannot be fetched here; the message is the reason."""


def unpacked(name: str, *, debian: Sequence[str] = (), wheels: Sequence[str] = ()) -> Path:
    """Return the folder of one runtime; its packages are downloaded and unpacked the first time.

    Args:
        name: of the folder.
        debian: Debian packages; packages that they depend on and that are not installed are added.
        wheels: requirements of pip, without what they depend on; only their libraries are unpacked.

    Raises:
        Unavailable: no network, no such package, or a tool is missing.
    """
    folder, partial = FOLDER / name, FOLDER / f"{name}.partial"
    if folder.exists():
        return folder
    shutil.rmtree(partial, ignore_errors=True)
    downloads = partial / "downloads"
    downloads.mkdir(parents=True)
    if debian:
        _unpack_debian(debian, downloads, partial)
    if wheels:
        _run([sys.executable, "-m", "pip", "download", "--quiet", "--retries", "1", "--no-deps",
              "--dest", str(downloads), *wheels], downloads)  # fmt: skip
        for wheel in sorted(downloads.iterdir()):
            _unpack_libraries(wheel, partial / "lib")
    shutil.rmtree(downloads)
    return partial.rename(folder)


def _unpack_debian(packages: Sequence[str], downloads: Path, target: Path) -> None:
    # Lists of packages of our own: those of the system may be missing, and only root may update them.
    state = FOLDER / "apt"
    (state / "lists" / "partial").mkdir(parents=True, exist_ok=True)
    (state / "cache" / "archives" / "partial").mkdir(parents=True, exist_ok=True)
    options = [
        f"-oDir::State::Lists={state / 'lists'}",
        f"-oDir::Cache={state / 'cache'}",
        "-oAPT::Sandbox::User=root",
        "-oAcquire::Retries=0",
        "-oAcquire::http::Timeout=20",
        "-oAcquire::https::Timeout=20",
    ]
    _run(["apt-get", *options, "update"], downloads)
    plan = _run(
        ["apt-get", *options, "--simulate", "--no-install-recommends", "install", *packages],
        downloads,
    )
    needed = [line.split()[1] for line in plan.splitlines() if line.startswith("Inst ")]
    _run(["apt-get", *options, "download", *(needed or packages)], downloads)
    for package in sorted(downloads.glob("*.deb")):
        _run(["dpkg", "-x", str(package), str(target)], downloads)


def _unpack_libraries(wheel: Path, target: Path) -> None:
    """Unpack what a wheel installs into the folder lib of an environment."""
    target.mkdir(exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.infolist():
            if ".data/data/lib/" in member.filename and not member.is_dir():
                (target / Path(member.filename).name).write_bytes(archive.read(member))


def _run(command: Sequence[str], folder: Path) -> str:
    """Run a command; return its output.

    Raises:
        Unavailable: it is missing, fails or takes too long.
    """
    try:
        result = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=_SECONDS
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Unavailable(f"{command[0]}: {error}") from error
    if result.returncode:
        reasons = [line for line in result.stderr.splitlines() if line.strip()] or ["no message"]
        raise Unavailable(f"{command[0]} failed: {reasons[-1]}")
    return result.stdout
