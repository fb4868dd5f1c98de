"""Whether settings survive being written down."""

from __future__ import annotations

import json

from ..contract.component import Settings
from ..pipeline.settings_check import escape_variables, validate_settings
from ..pipeline.yaml_source import Node, parse, to_yaml
from .judging import require


def check_settings(settings: Settings) -> None:
    """Write settings as JSON and as a pipeline file, and read them back.

    Raises:
        AssertionError: they are others then.
        PipelineError: the file is refused.
    """
    plain = settings.model_dump(mode="json")
    from_json = type(settings).model_validate_json(json.dumps(plain), strict=True)
    require(from_json == settings, "the settings do not survive being written as JSON")
    tree = parse(to_yaml(escape_variables({"settings": plain})), "settings").content
    written = tree["settings"] if isinstance(tree, dict) else Node({}, parse("", "").place)
    from_yaml = validate_settings(type(settings), written, "settings")
    require(from_yaml == settings, "the settings do not survive being written to a pipeline file")
