"""Where the files of a pipeline are, when its run is opened from another folder or after a move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...errors import RunError
from ...pipeline.pipeline import Item, Pipeline
from ...pipeline.settings_check import with_path
from ...toolkit.cache.remote import url_of
from ..folder import RunFolder

_PATH = "path"
"""The setting of scene loaders that names the folder of the data."""


def in_its_place(pipeline: Pipeline, folder: RunFolder, scene: Path | None) -> Pipeline:
    """Return a run's pipeline with the paths of existing files; it is recorded as before.

    Relative paths are those of the folder in which the run was started. If that was moved together with the
    run folder, they are found there.

    Args:
        scene: folder of the scene's data; None: as the pipeline says.

    Raises:
        RunError: the pipeline's scene has no folder.
    """
    bases = folder.started_in()
    items = {
        section: tuple(_item_in_place(item, bases) for item in items)
        for section, items in pipeline.items.items()
    }
    if scene is not None:
        loader = pipeline.one("scene")
        if _PATH not in type(loader.settings).model_fields:
            raise RunError(
                f"the scene loader {loader.name!r} reads no folder",
                where=f"--scene {scene}",
                fix="remove --scene",
            )
        settings = with_path(loader.settings, _PATH, scene if url_of(scene) else scene.absolute())
        items["scene"] = (replace(loader, settings=settings),)
    return replace(pipeline, items=items)


def _item_in_place(item: Item, bases: tuple[Path, ...]) -> Item:
    settings = item.settings
    for name, value in item.settings:
        if isinstance(value, Path) and not value.expanduser().is_absolute():
            found = next((base / value for base in bases if (base / value).exists()), None)
            if found is not None:
                settings = with_path(settings, name, found)
    return item if settings is item.settings else replace(item, settings=settings)
