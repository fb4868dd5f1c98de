"""Print the JSON schema of pipelines, for editors."""

from __future__ import annotations

import argparse
import json

from ..contract.command import Command
from .output import error_console

_EPILOG = """\
examples:
  stereogs schema > pipeline.schema.json

It holds the settings of every installed plugin, third parties' included. An editor that knows YAML (in
VS Code the extension YAML of Red Hat) completes and checks a pipeline whose first line is

  # yaml-language-server: $schema=pipeline.schema.json
"""


class Schema(Command):
    """The verb `schema`."""

    epilog = _EPILOG

    def run(self, arguments: argparse.Namespace) -> int:
        """Print it; plugins that cannot be loaded are told of, and left out."""
        from ..inspection.schema import pipeline_schema
        from ..plugins.discovery import Plugins

        plugins = Plugins()
        print(json.dumps(pipeline_schema(plugins.all()), indent=1))
        for fault in plugins.broken.values():
            error_console().print(str(fault))
        return 0
