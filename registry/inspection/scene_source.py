"""Components without a pipeline: a scene loader for a folder, or one component with its settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..contract.checks.scene import validate
from ..errors import SceneError
from ..pipeline.edits import apply_override, expand
from ..pipeline.pipeline import Item, load_pipeline
from ..pipeline.ready import is_pipeline_file, ready_pipelines
from ..pipeline.schedule import HostSettings
from ..pipeline.settings_check import escape_variables, validate_settings
from ..pipeline.yaml_source import Node, Place
from ..plugins.discovery import SCENE, Offer, Plugins, recognize
from ..toolkit.progress import progress

if TYPE_CHECKING:
    from ..contract.scene import Scene
    from ..pipeline.parts import Part

_COMMAND_LINE = Place("the command line")


class FoundLoader(NamedTuple):
    """A scene loader with its settings, and the seed of the run that it would load for."""

    item: Item
    seed: int = 0


def find_loader(
    data: Path, plugins: Plugins, *, format_name: str | None = None, changes: Sequence[str] = ()
) -> FoundLoader:
    """Return the loader for a folder, or the loader of a pipeline.

    Args:
        data: a folder, a pipeline's YAML file, or the name of a ready pipeline.
        format_name: the loader to use for a folder; None chooses the loader that recognizes it.
        changes: `key=value` or `scene.key=value`, settings of the loader.

    Raises:
        ExplainedError: the path does not exist, no loader or several recognize the folder, or a setting
            is wrong.
    """
    if not is_pipeline_file(data) and (data.exists() or data.as_posix() not in ready_pipelines()):
        offer = (
            recognize(data, plugins) if format_name is None else plugins.find(SCENE, format_name)
        )
        path = Node(escape_variables(str(data)), _COMMAND_LINE)
        return FoundLoader(single_item(offer, changes, {"path": path}))
    if format_name is not None:
        raise SceneError(
            "a pipeline file names its own loader",
            where=f"--format {format_name}",
            fix="leave --format out, or give the folder of the data",
        )
    overrides = [_qualified(text, SCENE.section) for text in changes]
    pipeline = load_pipeline(data, plugins, overrides=overrides)
    return FoundLoader(pipeline.one(SCENE.section), pipeline.training.seed)


def load(loader: Part) -> Scene:
    """Load a scene and validate it; raises an ExplainedError if the loader fails or it is not valid."""
    progress("reading")
    with loader.at_work():
        return validate(loader.component.load())


def single_item(
    offer: Offer, changes: Sequence[str] = (), written: Mapping[str, Node] | None = None
) -> Item:
    """Return the item of a component that no pipeline names.

    Args:
        changes: `key=value` or `section.key=value`, settings of the component.
        written: settings that the changes apply to.

    Raises:
        PipelineError: a change is malformed, or a setting is wrong.
    """
    section = offer.point.section
    root = Node({section: Node(dict(written or {}), _COMMAND_LINE)}, _COMMAND_LINE)
    for text in changes:
        apply_override(root, _qualified(text, section))
    settings = validate_settings(
        offer.settings_type, Node(expand(root.at((section,))), _COMMAND_LINE), section
    )
    return Item(offer.name, settings, HostSettings(use=offer.name), offer, _COMMAND_LINE)


def _qualified(change: str, section: str) -> str:
    """Return `key=value` as `section.key=value`, which may be written so already."""
    return f"{section}.{change.removeprefix(f'{section}.')}"
