"""Run the self-test of each device in its own process, and remember the result.

A broken driver may end or block the process that uses it. Times are remembered for each device and driver,
so that the choice of the default device costs seconds once.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .choice import Description

_MODULE = f"{__package__.rpartition('.')[0]}.self_test"
_SECONDS = 300
"""A child may take this long; compiling the kernels takes up to a minute."""


@dataclass(frozen=True)
class Trial:
    """Result of one device's self-test.

    Args:
        failure: what went wrong; None if the device passed.
        seconds: of one training iteration with 20,000 Gaussians at 320x240; infinite if it failed.
        image_error, gradient_error, depth_error: see `self_test.Verdict`.
    """

    failure: str | None
    seconds: float = math.inf
    image_error: float = math.nan
    gradient_error: float = math.nan
    depth_error: float = math.nan


def described(environment: Mapping[str, str] | None = None) -> list[Description] | str:
    """List the devices in a child process.

    Args:
        environment: of the child; None is that of this process.

    Returns:
        The devices, or why the child failed.
    """
    answer = _child([], environment)
    if isinstance(answer, str):
        return answer
    return [Description(**facts) for facts in answer["devices"]]


def tried(device: Description, environment: Mapping[str, str] | None = None) -> Trial:
    """Test and time a device in a child process, and remember the result; arguments as in `described`."""
    answer = _child([str(device.index)], environment)
    trial = Trial(failure=answer) if isinstance(answer, str) else Trial(**answer)
    _remember(device, trial)
    return trial


def seconds_of(devices: Sequence[Description]) -> list[float]:
    """Seconds of one training iteration, as remembered or measured now; infinite for those that fail."""
    known = _remembered()
    return [known[d.key] if d.key in known else tried(d).seconds for d in devices]


def _child(arguments: list[str], environment: Mapping[str, str] | None) -> Any:
    """Run the self-test's command line; return its answer, or a text that says why there is none."""
    command = [sys.executable, "-m", _MODULE, *arguments]
    try:
        result = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_SECONDS,
            env=environment,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        return f"the driver did not answer within {_SECONDS} seconds"
    except OSError as error:
        return f"no process could be started: {error}"
    answers = [line for line in result.stdout.splitlines() if line.startswith("{")]
    if result.returncode == 0 and answers:
        return json.loads(answers[-1])
    last = (result.stderr.strip().splitlines() or ["it wrote no message"])[-1]
    if result.returncode < 0:
        return f"the driver ended the process with signal {-result.returncode}: {last}"
    return f"the driver ended the process with exit status {result.returncode}: {last}"


def _file() -> Path | None:
    """Where times are remembered; None if caches are off."""
    named = os.environ.get("STEREOGS_CACHE")
    if named is not None:
        return Path(named, "devices.json") if named else None
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home, "stereogs", "devices.json")


def _remembered() -> dict[str, float]:
    """Seconds by `Description.key`; infinite for devices that failed."""
    file = _file()
    try:
        entries = json.loads(file.read_text("utf-8")) if file else {}
        return {str(key): float(entry["seconds"]) for key, entry in entries.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def _remember(device: Description, trial: Trial) -> None:
    """Add one result to the file; without effect if it cannot be written."""
    file = _file()
    if file is None:
        return
    try:
        entries = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError):
        entries = {}
    if not isinstance(entries, dict):
        entries = {}
    entries[device.key] = asdict(trial)
    partial = file.with_suffix(f".{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(entries, indent=1), "utf-8")
        partial.replace(file)
    except OSError:
        partial.unlink(missing_ok=True)
