"""Recognize the format of a folder of data by asking every scene loader."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from .contract.components import SceneLoader
from .discovery import OWN_PACKAGE, SCENE, Offer, Plugins
from .errors import SceneError
from .messages.suggestions import listing
from .toolkit.cache.remote import local_copy, url_of

_log = logging.getLogger(__name__)


def scene_loaders(plugins: Plugins) -> list[tuple[Offer, type[SceneLoader[Any]]]]:
    """Return every scene loader and its class, sorted by name; imports all plugins."""
    return [
        (offer, offer.component)
        for offer in plugins.all()
        if offer.point is SCENE and issubclass(offer.component, SceneLoader)
    ]


def recognizing(folder: Path, plugins: Plugins) -> list[Offer]:
    """Return every scene loader that recognizes an existing folder or file, sorted by name."""
    return [offer for offer, loader in scene_loaders(plugins) if loader.recognizes(folder)]


def recognize(folder: Path, plugins: Plugins) -> Offer:
    """Return the scene loader that recognizes a folder by its content, or a file, also a remote one.

    A loader of this project comes before those of other packages, which must be named.

    Raises:
        SceneError: the folder does not exist, or no loader or several recognize it.
    """
    named = url_of(folder) or str(folder)
    folder = local_copy(folder)
    if not folder.exists():
        raise SceneError(
            "there is no such folder of data",
            where=named,
            fix="give a folder of photographs or of a data set, or a pipeline file (.yaml)",
        )
    found = recognizing(folder, plugins)
    own = [offer for offer in found if offer.distribution == OWN_PACKAGE]
    if len(own) == 1 < len(found):
        others = listing(offer.use for offer in found if offer is not own[0])
        _log.info("%s is also read by %s, with --set scene.use=NAME", folder, others)
        return own[0]
    if len(found) == 1:
        return found[0]
    if found:
        names, first = ", ".join(offer.use for offer in found), found[0].use
        raise SceneError(
            f"the folder may be of several formats: {names}",
            where=named,
            fix=f"choose one: `check --format {first}`, `train --set scene.use={first}`",
        )
    if folder.is_file():
        raise SceneError(
            "this is a file, not a folder of data or a video",
            where=named,
            fix="give the folder that holds it, unpack an archive; `stereogs view FILE.ply` shows Gaussians",
        )
    loaders = scene_loaders(plugins)
    lines = ["the folder's format is not known. The loaders looked for:"]
    lines += [
        f"  {o.name}: {loader.recognized_by}" for o, loader in loaders if loader.recognized_by
    ]
    lines += [f"could not be loaded: {error.what}" for error in plugins.broken.values()]
    raise SceneError(
        "\n".join(lines),
        where=named,
        fix="give what one of them looks for, or name the loader: `check --format NAME`, "
        "`train --set scene.use=NAME`",
    )
