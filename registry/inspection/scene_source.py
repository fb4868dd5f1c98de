"""Scenes by themselves: the loader for a folder of data or for a pipeline file, without training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..contract.components import SceneLoader
from ..contract.hook_points import HOOK_POINTS
from ..contract.scene import validate
from ..errors import SceneError
from ..pipeline.edits import apply_override, expand
from ..pipeline.parts import build_part
from ..pipeline.pipeline import Item, load_pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.settings_check import escape_variables, validate_settings
from ..pipeline.yaml_source import Node, Place
from ..plugins import Offer, Plugins

if TYPE_CHECKING:
    from core_rasterizer import Device

    from ..contract.scene import Scene

_SCENE = next(point for point in HOOK_POINTS if point.section == "scene")
_PIPELINE_SUFFIXES = (".yaml", ".yml")


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
    """The loader for a folder, or of a pipeline file.

    Args:
        data: a folder, or a pipeline's YAML file.
        format_name: the loader to use for a folder; None asks the loaders which one knows it.
        changes: `key=value` or `scene.key=value`, settings of the loader.

    Raises:
        ExplainedError: nothing is there, no loader or several know the folder, or wrong settings.
    """
    overrides = [_qualified(text) for text in changes]
    if data.suffix.lower() in _PIPELINE_SUFFIXES and not data.is_dir():
        if format_name is not None:
            raise SceneError(
                "a pipeline file names its own loader",
                where=f"--format {format_name}",
                fix="leave --format out, or give the folder of the data",
            )
        pipeline = load_pipeline(data, plugins, overrides=overrides)
        return FoundLoader(pipeline.one(_SCENE.section), pipeline.training.seed)
    return FoundLoader(_folder_item(data, plugins, format_name, overrides))


def load(found: FoundLoader, device: Device) -> Scene:
    """What a loader loads, validated.

    Raises:
        ExplainedError: what the loader says.
    """
    part = build_part(found.item, found.seed, device)
    with part.at_work():
        return validate(part.component.load())


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
    found = [offer for offer, loader in loaders if loader.recognizes(folder)]
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(offer.name for offer in found)
        raise SceneError(
            f"the folder may be of several formats: {names}",
            where=str(folder),
            fix=f"say which, for example --format {found[0].name}",
        )
    lines = ["the folder's format is not known. These were looked for:"]
    lines += [f"  {o.name}: {k.recognized_by}" for o, k in loaders if k.recognized_by]
    lines += [f"not asked: {error.what}" for error in plugins.broken.values()]
    raise SceneError(
        "\n".join(lines),
        where=str(folder),
        fix="give the folder that holds one of them, or name the loader with --format",
    )


def scene_loaders(plugins: Plugins) -> list[tuple[Offer, type[SceneLoader[Any]]]]:
    """Every scene loader and its class, by name; imports all plugins."""
    return [
        (offer, offer.component)
        for offer in plugins.all()
        if offer.point is _SCENE and issubclass(offer.component, SceneLoader)
    ]


def _qualified(text: str) -> str:
    start = f"{_SCENE.section}."
    return text if text.startswith(start) else start + text


def _folder_item(
    data: Path, plugins: Plugins, format_name: str | None, overrides: Sequence[str]
) -> Item:
    """The item that a pipeline would have with `scene: {use: ..., path: ..., ...}`."""
    offer = recognize(data, plugins) if format_name is None else plugins.find(_SCENE, format_name)
    place = Place("the command line")
    path = Node(escape_variables(str(data)), place)
    root = Node({_SCENE.section: Node({"path": path}, place)}, place)
    for text in overrides:
        apply_override(root, text)
    assert isinstance(root.content, dict)
    settings = validate_settings(
        offer.settings_type, Node({**expand(root.content[_SCENE.section])}, place), _SCENE.section
    )
    return Item(offer.name, settings, HostSettings(use=offer.name), offer, place)
