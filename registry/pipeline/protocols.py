"""Evaluation protocols: the conditions under which two published numbers are comparable.

Packages provide them as YAML files through the entry-point group `stereogs.protocols`; `protocol_rules`
applies one to a pipeline.
"""

from __future__ import annotations

from typing import Any, Literal

from ..contract.component import Settings
from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing
from .ready import PROTOCOLS, only_file, packaged_files
from .settings_check import validate_settings
from .yaml_source import Node, parse


class Protocol(Settings):
    """One protocol. `loaders` and `metrics` are imposed on a pipeline; the rest says what they mean."""

    name: str
    """As a pipeline writes it, for example "llff-3"."""
    title: str
    """The data set and the number of training views, for people."""
    scenes: tuple[str, ...]
    """The scenes that published averages go over."""
    train_views: int
    """How many views a method may train on."""
    split: str
    """Which views train and which test."""
    scale: str
    """The size that images are trained and scored at."""
    image_source: Literal["folder", "resize"]
    """"folder": the small images that the data set brings; "resize": made from the large ones."""
    filter: str | None
    """What images are made smaller with, where `image_source` is "resize"."""
    background: Literal["none", "white", "black"]
    """What lies behind transparent images, in photographs and renders alike."""
    masks: str | None
    """Which pixels count in metrics; null means all."""
    notes: str | None = None
    """Where published papers differ among themselves."""
    loaders: dict[str, dict[str, Any]]
    """Settings of the scene loader, for each loader that can follow the protocol."""
    metrics: tuple[dict[str, Any], ...]
    """The metrics that must be measured, with the settings that matter."""


def protocol_names() -> tuple[str, ...]:
    """Return the names of the installed protocols, sorted."""
    return tuple(packaged_files(PROTOCOLS))


def load_protocol(name: str) -> Protocol:
    """Return the protocol of that name; see `read_protocol`."""
    return validate_settings(Protocol, read_protocol(name, "protocol"), "protocol")


def read_protocol(name: str, where: str) -> Node:
    """Return a protocol's file as a tree, which keeps the lines.

    Args:
        where: place that names the protocol, for errors.

    Raises:
        PipelineError: the name is unknown, or several packages provide it.
    """
    files = packaged_files(PROTOCOLS)
    fix = f"protocols: {listing(files)}; or remove `protocol`"
    if name not in files:
        what = f"unknown protocol {name!r}{did_you_mean(name, files)}"
        raise PipelineError(what, where=where, fix=fix)
    file = only_file(f"the protocol {name!r}", files[name], where, "uninstall one of them")
    return parse(file.read_text("utf-8"), f"protocols/{file.name}")
