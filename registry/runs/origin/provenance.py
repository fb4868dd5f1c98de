"""Where a result comes from: versions, commit, machine, device, seed, command line."""

from __future__ import annotations

import platform
import re
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any
from uuid import uuid4

from core_rasterizer import Device

from ...pipeline.pipeline import Pipeline
from .source_code import checkout, package_source

_OURS = "stereogs-plugins"
_NAME = re.compile(r"[A-Za-z0-9._-]+")


def provenance(pipeline: Pipeline, device: Device) -> dict[str, Any]:
    """Facts that are needed to repeat a run, as plain JSON values; the command line as typed."""
    return {
        "run": uuid4().hex,
        "seed": pipeline.training.seed,
        **circumstances(pipeline, device),
        "resumed": [],
    }


def circumstances(pipeline: Pipeline, device: Device) -> dict[str, Any]:
    """What is at work now, as plain JSON values: for the start of a run, and each time it is resumed."""
    offers = {item.qualified_name: item.offer for item in pipeline}
    authors = dict.fromkeys(offer.distribution for offer in offers.values())
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "device": describe_device(device),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "python": sys.version.split()[0],
        "source": checkout(),
        "packages": {name: _version(name) for name in _packages()},
        "plugins": {
            name: f"{offer.distribution} {offer.version}" for name, offer in offers.items()
        },
        "plugin_sources": {name: package_source(name) for name in authors if name != _OURS},
    }


def _packages() -> list[str]:
    """This package and what it always needs, as its metadata lists it."""
    needed = [text for text in requires(_OURS) or () if "extra ==" not in text]
    return [_OURS, *(found[0] for text in needed if (found := _NAME.match(text)))]


def describe_device(device: Device) -> dict[str, str]:
    """The OpenCL device as plain JSON values; with `built_for` where `Device.built_for` says something."""
    told = device.built_for
    return {
        "name": device.name,
        "platform": device.platform,
        "kind": device.kind,
        "driver": device.driver,
        **({"built_for": told} if told else {}),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
