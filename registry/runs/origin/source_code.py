"""Which state of the project's own code is at work, where it runs from a checkout."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[2]
_PACKAGES = ("core_rasterizer", "registry", "stereogs_plugins")
_SECONDS = 10.0


def checkout(root: Path = _ROOT) -> dict[str, Any] | None:
    """The commit, and whether the packages differ from it; None outside a checkout or without git.

    Args:
        root: the folder that holds the packages.
    """
    if not (root / ".git").exists():  # installed; a repository around site-packages is not ours
        return None
    commit = _git(root, "rev-parse", "HEAD")
    changes = _git(root, "status", "--porcelain", "--", *_PACKAGES)
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
