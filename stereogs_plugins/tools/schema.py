"""Print the JSON schema of pipelines, for editors."""

from __future__ import annotations

import argparse
import json

from registry import Command, Register, hookimpl
from registry.commands import console

_EPILOG = """\
examples:
  stereogs schema > pipeline.schema.json

The schema contains the settings of every installed plugin. An editor with YAML support (in VS Code the
extension YAML by Red Hat) completes and checks a pipeline whose first line is

  # yaml-language-server: $schema=pipeline.schema.json
"""


class Schema(Command):
    epilog = _EPILOG

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the schema, without plugins that cannot be loaded, and their errors."""
        from registry.inspection import pipeline_schema
        from registry.plugins import Plugins

        plugins = Plugins()
        print(json.dumps(pipeline_schema(plugins.all()), indent=1))
        for fault in plugins.broken.values():
            console(stderr=True).print(str(fault))
        return 0


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("schema", Schema)
