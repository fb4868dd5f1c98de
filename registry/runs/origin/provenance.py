"""Where a result comes from: versions, commit, machine, device, seed, command line."""

from __future__ import annotations

import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from uuid import uuid4

from core_rasterizer import Device

from ...pipeline.pipeline import Pipeline
from .source_code import checkout

_PACKAGES = ("stereogs-plugins", "torch", "pyopencl", "onnxruntime", "numpy", "pluggy", "pydantic")


def provenance(pipeline: Pipeline, device: Device) -> dict[str, Any]:
    """Facts that are needed to repeat a run, as plain JSON values; the command line as typed."""
    return {
        "run": uuid4().hex,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "seed": pipeline.training.seed,
        "device": describe_device(device),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "python": sys.version.split()[0],
        "source": checkout(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "plugins": {
            item.qualified_name: f"{item.offer.distribution} {item.offer.version}"
            for item in pipeline
        },
    }


def describe_device(device: Device) -> dict[str, str]:
    """The OpenCL device as plain JSON values."""
    return {
        "name": device.name,
        "platform": device.platform,
        "kind": device.kind,
        "driver": device.driver,
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
