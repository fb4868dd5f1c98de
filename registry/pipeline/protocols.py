"""Evaluation protocols as data: what must be equal before two published numbers may be compared.

The files are data/protocols/*.yaml of this package; `protocol_rules` imposes one on a pipeline.
"""

from __future__ import annotations

from importlib import resources
from typing import Any, Literal

from ..contract.component import Settings
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
    """The protocols there are, sorted."""
    files = (file.name for file in _folder().iterdir())
    return tuple(sorted(n.removesuffix(".yaml") for n in files if n.endswith(".yaml")))


def load_protocol(name: str) -> Protocol:
    """The protocol of that name; see `protocol_names`."""
    return validate_settings(Protocol, read_protocol(name), "protocol")


def read_protocol(name: str) -> Node:
    """The file of that protocol as a tree, for its places."""
    file = f"{name}.yaml"
    return parse(_folder().joinpath(file).read_text("utf-8"), f"protocols/{file}")


def _folder() -> Any:
    return resources.files("registry").joinpath("data", "protocols")
