"""The scene loader for a folder, or of a pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from registry.discovery import PRIORS, SCENE, Plugins
from registry.errors import SceneError
from registry.pipeline.pipeline import Item, Pipeline, load_pipeline, with_named_priors
from registry.pipeline.ready import is_pipeline_file, ready_pipelines
from registry.pipeline.settings_check import escape_variables
from registry.pipeline.single_item import COMMAND_LINE, qualified, single_item
from registry.pipeline.training_settings import TrainingSettings
from registry.pipeline.yaml_source import Node
from registry.recognition import recognize
from registry.toolkit.cache.remote import url_of

if TYPE_CHECKING:
    from core_rasterizer import Device, Engine
    from registry import Scene


class FoundLoader(NamedTuple):
    """The loader of a pipeline; of a folder, a pipeline of the loader and the priors that it names."""

    pipeline: Pipeline

    @property
    def item(self) -> Item:
        """The loader with its settings."""
        return self.pipeline.one(SCENE.section)

    def load(self, device: Device | Engine) -> Scene:
        """Load and validate the scene."""
        from registry.pipeline.parts import Parts, load_scene

        return load_scene(Parts(self.pipeline, device).one(SCENE.section))


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
        path = Node(escape_variables(url_of(data) or str(data)), COMMAND_LINE)
        loader = single_item(offer, changes, {"path": path})
        items = {
            SCENE.section: (loader,),
            PRIORS.section: with_named_priors(loader, (), plugins),
        }
        return FoundLoader(Pipeline(offer.name, items, TrainingSettings()))
    if format_name is not None:
        raise SceneError(
            "a pipeline file names its own loader",
            where=f"--format {format_name}",
            fix="leave --format out, or give the folder of the data",
        )
    overrides = [qualified(text, SCENE.section) for text in changes]
    return FoundLoader(load_pipeline(data, plugins, overrides=overrides))
