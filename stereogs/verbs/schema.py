"""Print the JSON schema of pipelines, for editors.

With it editors complete and check YAML. The dialect is JSON Schema 2020-12
(https://json-schema.org/draft/2020-12). Rules that involve several components are not part of it; `stereogs
train` checks them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from typing import Any

from pydantic.errors import PydanticInvalidForJsonSchema

from registry import Settings
from registry.contract.hook_points import PIPELINE_POINTS, HookPoint
from registry.discovery import Offer, Plugins
from registry.pipeline.protocols import ProtocolChoice, protocol_names
from registry.pipeline.schedule import HostSettings, Schedule
from registry.pipeline.training_settings import PER_VIEW, TrainingSettings

from ..command_line.command import Command
from ..command_line.output import console

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_NOTES = ("description", "default", "title")
"""Keys of a schema that do not restrict the value."""

Schema = dict[str, Any]

_EPILOG = """\
examples:
  stereogs schema > pipeline.schema.json

The schema contains the settings of every installed plugin. An editor with YAML support (in VS Code the
extension YAML by Red Hat) completes and checks a pipeline whose first line is

  # yaml-language-server: $schema=pipeline.schema.json
"""


class PrintSchema(Command):
    epilog = _EPILOG

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the schema, without plugins that cannot be loaded, and their errors."""
        plugins = Plugins()
        print(json.dumps(pipeline_schema(plugins.all()), indent=1))
        for fault in plugins.broken.values():
            console(stderr=True).print(str(fault))
        return 0


def pipeline_schema(offers: Iterable[Offer]) -> Schema:
    """Return the schema of pipelines that name these components, for example `Plugins().all()`."""
    definitions: dict[str, Schema] = {"training": {}}
    training = _described(TrainingSettings, "training", definitions)
    length = training["properties"]["iterations"]
    training["properties"]["iterations"] = _or_text(
        length, f"^{PER_VIEW.pattern}$", "A number for each training view."
    )
    definitions["training"] = training
    protocol = _described(ProtocolChoice, "protocol", definitions)
    protocol["properties"]["use"]["enum"] = list(protocol_names())
    names = {"enum": [*protocol_names(), None]}
    properties: Schema = {
        "name": {"type": "string", "description": "For titles and for the run folder."},
        "protocol": {"anyOf": [names, protocol], "description": "What scores are comparable with."},
    }
    all_offers = list(offers)
    for point in PIPELINE_POINTS:
        own = [offer for offer in all_offers if offer.point is point]
        properties[point.section] = _section(point, own, definitions)
    properties["training"] = {"anyOf": [{"$ref": "#/$defs/training"}, {"type": "null"}]}
    return {
        "$schema": DIALECT,
        "title": "A StereoGS pipeline",
        "type": "object",
        "properties": properties,
        "required": ["name", *(point.section for point in PIPELINE_POINTS if point.required)],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _section(point: HookPoint, offers: list[Offer], definitions: dict[str, Schema]) -> Schema:
    """One component, a list of them, or either; a bare name, or a mapping that depends on its `use`."""
    names = [offer.use for offer in offers]
    cases = []
    for offer in offers:
        key = f"{point.section}.{offer.use}".replace("/", ".")
        definitions[key] = _settings(point, offer, key, definitions)
        uses = {"properties": {"use": {"const": offer.use}}, "required": ["use"]}
        cases.append({"if": uses, "then": {"$ref": f"#/$defs/{key}"}})
    mapping: Schema = {
        "type": "object",
        "properties": {"use": {"enum": names, "description": f"Which {point.title}."}},
        "required": ["use"],
    }
    if cases:
        mapping["allOf"] = cases
    definitions[point.section] = {"anyOf": [{"enum": names}, mapping]}
    one = {"$ref": f"#/$defs/{point.section}"}
    shapes: list[Schema] = []
    if point.holds != "list":
        shapes.append(one)
    if point.holds != "one":
        shapes.append({"type": "array", "items": one})
    if not point.required:
        shapes.append({"type": "null"})
    return {"description": (point.base.__doc__ or "").partition("\n")[0], "anyOf": shapes}


def _settings(point: HookPoint, offer: Offer, key: str, definitions: dict[str, Schema]) -> Schema:
    """The settings beside `use: NAME`: the component's own, and those that the host reads."""
    try:
        own = _described(offer.settings_type, key, definitions)
    except PydanticInvalidForJsonSchema as error:
        return {"description": f"Its settings cannot be described: {error.message}"}
    described = _described(HostSettings, "host", definitions)["properties"]
    others = {"type": "array", "items": {"$ref": f"#/$defs/{point.section}"}}
    described["fallbacks"] = {**others, "description": "Used if a file is missing; best first."}
    properties = {name: dict(described[name]) for name in point.host_settings}
    for name, default in offer.component.host_defaults.written().items():
        properties[name]["default"] = default
    properties["use"].pop("type")
    for name in properties.keys() & Schedule.model_fields.keys():
        properties[name] = _or_text(
            properties[name], r"^[0-9]+(\.[0-9]+)?%$", "A share of the run."
        )
    summary = (offer.component.__doc__ or "").strip().partition("\n")[0]
    return {
        **own,
        "description": summary,
        "properties": {**properties, **own.get("properties", {})},
    }


def _or_text(schema: Schema, pattern: str, description: str) -> Schema:
    """Return the schema of a value that may also be a text of a pattern."""
    text = {"type": "string", "pattern": pattern, "description": description}
    notes = {key: value for key, value in schema.items() if key in _NOTES}
    return {"anyOf": [{k: v for k, v in schema.items() if k not in notes}, text], **notes}


def _described(model: type[Settings], key: str, definitions: dict[str, Schema]) -> Schema:
    """Return pydantic's schema of settings; nested models are added to the definitions, below `key`."""
    schema = model.model_json_schema(ref_template=f"#/$defs/{key}.{{model}}")
    for name, inner in schema.pop("$defs", {}).items():
        definitions[f"{key}.{name}"] = inner
    return schema
