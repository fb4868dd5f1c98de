"""Pipelines: read from YAML, checked, changed, and their components built."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .blame import blame as blamed
    from .edits import (
        SECTIONS,
        TOP_LEVEL,
        apply_override,
        component_items,
        expand,
        item_names,
        set_value,
    )
    from .parts import Part, Parts, build_part
    from .pipeline import Item, Pipeline, component_item, leaves, load_pipeline, parse_pipeline
    from .pipeline import build_pipeline as checked_pipeline
    from .protocols import ProtocolChoice, load_protocol, protocol_names
    from .ready import find_pipeline, ready_pipelines
    from .repeats import digests
    from .schedule import HostSettings, Schedule
    from .settings_check import escape_variables, plain, validate_settings
    from .training_settings import PER_VIEW, TrainingSettings, iterations_of_a_run
    from .yaml_source import Node, Place, parse, read, resolve, to_yaml
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "PER_VIEW",
    "SECTIONS",
    "TOP_LEVEL",
    "HostSettings",
    "Item",
    "Node",
    "Part",
    "Parts",
    "Pipeline",
    "Place",
    "ProtocolChoice",
    "Schedule",
    "TrainingSettings",
    "apply_override",
    "blamed",
    "build_part",
    "checked_pipeline",
    "component_item",
    "component_items",
    "digests",
    "escape_variables",
    "expand",
    "find_pipeline",
    "item_names",
    "iterations_of_a_run",
    "leaves",
    "load_pipeline",
    "load_protocol",
    "parse",
    "parse_pipeline",
    "plain",
    "protocol_names",
    "read",
    "ready_pipelines",
    "resolve",
    "set_value",
    "to_yaml",
    "validate_settings",
]
