"""What a pipeline file may say, as a JSON schema: with it editors complete and check YAML.

The dialect is JSON Schema 2020-12 (https://json-schema.org/draft/2020-12). A schema cannot know what
depends on more than one component; `stereogs train` checks that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from pydantic.errors import PydanticInvalidForJsonSchema

from ..contract.component import Settings
from ..contract.hook_points import PIPELINE_POINTS, HookPoint
from ..pipeline.protocol_rules import ProtocolChoice
from ..pipeline.protocols import protocol_names
from ..pipeline.schedule import HostSettings
from ..pipeline.training_settings import PER_VIEW, TrainingSettings
from ..plugins.discovery import Offer

DIALECT = "https://json-schema.org/draft/2020-12/schema"
HEADER = "# yaml-language-server: $schema="
"""A YAML file's first line binds it to a schema: this, then the schema's address."""

_SHARES = ("start", "stop", "every", "phase")
"""Numbers of iterations that may be shares of the run."""
_SHARE = {
    "type": "string",
    "pattern": r"^[0-9]+(\.[0-9]+)?%$",
    "description": "A share of the run.",
}
_PER_VIEW = {
    "type": "string",
    "pattern": f"^{PER_VIEW.pattern}$",
    "description": "So many for each training view.",
}
_NOTES = ("description", "default", "title")
"""What a schema says about a value beside its shape."""

Schema = dict[str, Any]


def pipeline_schema(offers: Iterable[Offer]) -> Schema:
    """The schema of pipelines that name these components.

    Args:
        offers: for example `Plugins().all()`.
    """
    definitions: dict[str, Schema] = {"training": {}}
    training = _described(TrainingSettings, "training", definitions)
    length = training["properties"]["iterations"]
    training["properties"]["iterations"] = _or_text(length, _PER_VIEW)
    definitions["training"] = training
    protocol = _described(ProtocolChoice, "protocol", definitions)
    protocol["properties"]["use"]["enum"] = list(protocol_names())
    names = {"enum": [*protocol_names(), None]}
    properties: Schema = {
        "name": {"type": "string", "description": "For titles and for the run folder."},
        "protocol": {"anyOf": [names, protocol], "description": "What scores are comparable with."},
    }
    by_section: dict[str, list[Offer]] = {point.section: [] for point in PIPELINE_POINTS}
    for offer in offers:
        if offer.point.in_pipeline:
            by_section[offer.point.section].append(offer)
    for point in PIPELINE_POINTS:
        properties[point.section] = _section(point, by_section[point.section], definitions)
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
    """One component, a list of them, or either."""
    definitions[point.section] = _component(point, offers, definitions)
    one = {"$ref": f"#/$defs/{point.section}"}
    shapes: list[Schema] = []
    if point.holds != "list":
        shapes.append(one)
    if point.holds != "one":
        shapes.append({"type": "array", "items": one})
    if not point.required:
        shapes.append({"type": "null"})
    return {"description": (point.base.__doc__ or "").partition("\n")[0], "anyOf": shapes}


def _component(point: HookPoint, offers: list[Offer], definitions: dict[str, Schema]) -> Schema:
    """A bare name, or a mapping whose settings depend on what it uses."""
    names = [offer.name for offer in offers]
    cases = []
    for offer in offers:
        key = f"{point.section}.{offer.name}"
        definitions[key] = _settings(point, offer, key, definitions)
        uses = {"properties": {"use": {"const": offer.name}}, "required": ["use"]}
        cases.append({"if": uses, "then": {"$ref": f"#/$defs/{key}"}})
    mapping: Schema = {
        "type": "object",
        "properties": {"use": {"enum": names, "description": f"Which {point.title}."}},
        "required": ["use"],
    }
    if cases:
        mapping["allOf"] = cases
    return {"anyOf": [{"enum": names}, mapping]}


def _settings(point: HookPoint, offer: Offer, key: str, definitions: dict[str, Schema]) -> Schema:
    """What may stand beside `use: NAME`: the component's own settings, and what the host lends."""
    try:
        own = _described(offer.settings_type, key, definitions)
    except PydanticInvalidForJsonSchema as error:
        return {"description": f"Its settings cannot be described: {error.message}"}
    summary = (offer.component.__doc__ or "").strip().partition("\n")[0]
    lent = dict(_lent(point, definitions))
    return {**own, "description": summary, "properties": {**lent, **own.get("properties", {})}}


def _lent(point: HookPoint, definitions: dict[str, Schema]) -> Iterator[tuple[str, Schema]]:
    described = _described(HostSettings, "host", definitions)["properties"]
    for name in point.host_settings:
        schema = {k: v for k, v in described[name].items() if name != "use" or k != "type"}
        if name in _SHARES:
            schema = _or_text(schema, _SHARE)
        yield name, schema


def _or_text(schema: Schema, text: Schema) -> Schema:
    """What may be written in words too."""
    notes = {key: value for key, value in schema.items() if key in _NOTES}
    return {"anyOf": [{k: v for k, v in schema.items() if k not in notes}, text], **notes}


def _described(model: type[Settings], key: str, definitions: dict[str, Schema]) -> Schema:
    """Pydantic's schema of settings; those that it refers to go to the definitions, below `key`."""
    schema = model.model_json_schema(ref_template=f"#/$defs/{key}.{{model}}")
    for name, inner in schema.pop("$defs", {}).items():
        definitions[f"{key}.{name}"] = inner
    return schema
