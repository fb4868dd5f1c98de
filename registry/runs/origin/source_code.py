"""Which state of the code is at work: the project's own where it runs from a checkout, and plugins'."""

from __future__ import annotations

import json
import os
import subprocess
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname

_ROOT = Path(__file__).parents[3]
_PACKAGES = ("core_rasterizer", "registry", "stereogs", "stereogs_plugins")
_SECONDS = 10.0


def checkout(root: Path = _ROOT) -> dict[str, Any] | None:
    """The commit, and whether the packages differ from it; None outside a checkout or without git.

    Args:
        root: the folder that holds the packages.
    """
    if not (root / ".git").exists():  # installed; a repository around site-packages is not ours
        return None
    return _state(root, *_PACKAGES)


def package_source(name: str) -> dict[str, Any] | None:
    """The commit that an installed package was made from, as the installer noted it (PEP 610).

    Of one that is installed editable, the commit that is checked out, and whether its files differ; None
    where nothing is noted, as for packages from an index.
    """
    try:
        noted = json.loads(distribution(name).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError, OSError):
        return None
    if "vcs_info" in noted:
        return {"commit": noted["vcs_info"]["commit_id"], "dirty": False}
    place = urlparse(noted.get("url", ""))
    folder = Path(url2pathname(place.path))
    if place.scheme != "file" or not noted.get("dir_info", {}).get("editable"):
        return None
    return _state(folder, ".") if _git(folder, "ls-files", "--", ".") else None


def _state(folder: Path, *parts: str) -> dict[str, Any] | None:
    """The commit of the checkout around a folder, and whether parts of the folder differ from it."""
    commit = _git(folder, "rev-parse", "HEAD")
    changes = _git(folder, "status", "--porcelain", "--", *parts)
    if commit is None or changes is None:
        return None
    return {"commit": commit, "dirty": bool(changes)}


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments],
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            capture_output=True,
            text=True,
            timeout=_SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
