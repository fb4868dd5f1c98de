"""Which scene loader knows a folder by what lies in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..contract.components import SceneLoader
from ..contract.hook_points import HOOK_POINTS
from ..errors import SceneError
from .discovery import Offer, Plugins

SCENE = next(point for point in HOOK_POINTS if point.section == "scene")
"""The hook point of scene loaders."""


def recognize(folder: Path, plugins: Plugins) -> Offer:
    """The one loader that knows a folder by its content.

    Raises:
        SceneError: it is no folder, or none or several know it; says what each looks for.
    """
    if not folder.is_dir():
        raise SceneError(
            "there is no such folder of data",
            where=str(folder),
            fix="give a folder of photographs or of a data set, or a pipeline file (.yaml)",
        )
    loaders = scene_loaders(plugins)
    found = recognizing(folder, plugins)
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(offer.name for offer in found)
        raise SceneError(
            f"the folder may be of several formats: {names}",
            where=str(folder),
            fix=f"say which: `check --format {found[0].name}`, `train --set scene.use={found[0].name}`",
        )
    lines = ["the folder's format is not known. These were looked for:"]
    lines += [f"  {o.name}: {k.recognized_by}" for o, k in loaders if k.recognized_by]
    lines += [f"not asked: {error.what}" for error in plugins.broken.values()]
    raise SceneError(
        "\n".join(lines),
        where=str(folder),
        fix="give the folder that holds one of them, or name the loader: `check --format NAME`, "
        "`train --set scene.use=NAME`",
    )


def recognizing(folder: Path, plugins: Plugins) -> list[Offer]:
    """Every loader that knows an existing folder, by name."""
    return [offer for offer, loader in scene_loaders(plugins) if loader.recognizes(folder)]


def scene_loaders(plugins: Plugins) -> list[tuple[Offer, type[SceneLoader[Any]]]]:
    """Every scene loader and its class, by name; imports all plugins."""
    return [
        (offer, offer.component)
        for offer in plugins.all()
        if offer.point is SCENE and issubclass(offer.component, SceneLoader)
    ]
