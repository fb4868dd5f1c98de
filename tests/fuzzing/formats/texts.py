"""Files that people write or that runs leave behind: pipelines and results."""

from __future__ import annotations

import json
import os
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from unittest import mock

from registry.runs import read_results
from tests.fuzzing.target import Target
from tests.host import GROUP, Plugins, Results, load_pipeline, parse_pipeline
from tests.registry.runs.test_results_file import RESULTS

_ROOT = Path(__file__).parents[3]
ENVIRONMENT = {"STEREOGS_DATA": "data", "STEREOGS_MODELS": "models"}


def shipped_plugins() -> Plugins:
    """All components that the project ships, whatever else is installed."""
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    entries = project["entry-points"][GROUP].items()
    return Plugins([EntryPoint(name, module, GROUP) for name, module in entries])


class PipelineFiles(Target):
    """Shipped pipelines; one that is accepted means the same once it is written out."""

    name = "pipelines"

    def __init__(self, folder: Path) -> None:
        self._plugins = shipped_plugins()
        super().__init__(folder)

    def write(self) -> tuple[str, ...]:
        """Copies of some in the folder `pipelines`; between them they have every section."""
        shipped = [_ROOT / "pipelines" / f"{name}.yaml" for name in ("3dgs", "stereogs_dropout")]
        for path in shipped:
            (self.folder / path.name).write_bytes(path.read_bytes())
        return tuple(path.name for path in shipped)

    def accepts(self, file: str, content: bytes) -> bool:
        """Read the one pipeline that is damaged."""
        self._chosen = file
        return super().accepts(file, content)

    _chosen = "3dgs.yaml"

    def read(self) -> None:
        """The one that is damaged."""
        with mock.patch.dict(os.environ, ENVIRONMENT):
            pipeline = load_pipeline(self.folder / self._chosen, self._plugins)
            assert parse_pipeline(pipeline.to_yaml(), self._plugins) == pipeline


class ResultsFiles(Target):
    """A results.json; one that is accepted is valid by type and range."""

    name = "results"

    def write(self) -> tuple[str, ...]:
        """One."""
        (self.folder / "results.json").write_text(json.dumps(RESULTS, indent=1))
        return ("results.json",)

    def read(self) -> None:
        """Read it twice: what was accepted is a document of the same kind."""
        found = read_results(self.folder / "results.json")
        Results.model_validate_json(json.dumps(found), strict=True)
