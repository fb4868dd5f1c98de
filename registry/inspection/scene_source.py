"""Scenes by themselves: the loader for a folder of data or for a pipeline file, without training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..contract.checks.scene import validate
from ..errors import SceneError
from ..pipeline.pipeline import Item, load_pipeline
from ..pipeline.ready import is_pipeline_file, ready_pipelines
from ..pipeline.settings_check import escape_variables
from ..pipeline.yaml_source import Node
from ..plugins.discovery import Plugins
from ..plugins.recognition import SCENE, recognize
from .single_item import COMMAND_LINE, qualified, single_item

if TYPE_CHECKING:
    from ..contract.scene import Scene
    from ..pipeline.parts import Part


class FoundLoader(NamedTuple):
    """A scene loader with its settings, and the seed of the run that it would load for."""

    item: Item
    seed: int = 0


def find_loader(
    data: Path,
    plugins: Plugins,
    *,
    format_name: str | None = None,
    changes: Sequence[str] = (),
) -> FoundLoader:
    """The loader for a folder, or of a pipeline.

    Args:
        data: a folder, a pipeline's YAML file, or the name of a ready pipeline.
        format_name: the loader to use for a folder; None asks the loaders which one knows it.
        changes: `key=value` or `scene.key=value`, settings of the loader.

    Raises:
        ExplainedError: nothing is there, no loader or several know the folder, or wrong settings.
    """
    overrides = [qualified(text, SCENE.section) for text in changes]
    if is_pipeline_file(data) or (not data.exists() and data.as_posix() in ready_pipelines()):
        if format_name is not None:
            raise SceneError(
                "a pipeline file names its own loader",
                where=f"--format {format_name}",
                fix="leave --format out, or give the folder of the data",
            )
        pipeline = load_pipeline(data, plugins, overrides=overrides)
        return FoundLoader(pipeline.one(SCENE.section), pipeline.training.seed)
    return FoundLoader(_folder_item(data, plugins, format_name, overrides))


def load(loader: Part) -> Scene:
    """Load a scene and validate it.

    Raises:
        ExplainedError: raised by the loader, or the scene is not valid.
    """
    with loader.at_work():
        return validate(loader.component.load())


def _folder_item(
    data: Path, plugins: Plugins, format_name: str | None, overrides: Sequence[str]
) -> Item:
    """The item that a pipeline would have with `scene: {use: ..., path: ..., ...}`."""
    offer = recognize(data, plugins) if format_name is None else plugins.find(SCENE, format_name)
    path = Node(escape_variables(str(data)), COMMAND_LINE)
    return single_item(offer, overrides, {"path": path})
