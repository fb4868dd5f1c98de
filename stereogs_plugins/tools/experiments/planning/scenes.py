"""The scenes of an ablation: names in STEREOGS_DATA, paths, or whole scene loaders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

from registry.errors import PipelineError
from registry.pipeline import Node, item_names

from .variations import Change

DATA = "STEREOGS_DATA"


@dataclass(frozen=True)
class AblatedScene:
    """A scene to train on.

    Args:
        label: what tables call it.
        change: puts it into the pipeline; None keeps the pipeline's own.
    """

    label: str
    change: Change | None


def find_scenes(root: Node, written: tuple[Node, ...]) -> tuple[AblatedScene, ...]:
    """The scenes as written, or the pipeline's own if there are none.

    A text without a slash is a folder in STEREOGS_DATA, with one it is a path; both become the
    `path` of the pipeline's loader. A mapping is a loader of its own.

    Raises:
        PipelineError: a scene that is neither, or two with the same label.
    """
    if not written:
        assert isinstance(root.content, dict)
        return (AblatedScene(_label(root.content["scene"]), None),)
    scenes: dict[str, AblatedScene] = {}
    for node in written:
        scene = AblatedScene(_label(node), _change(node))
        if scene.label in scenes:
            raise PipelineError(
                f"two scenes are called {scene.label!r}",
                where=str(node.place),
                fix="remove one, or give it a name of its own: {use: LOADER, name: ..., path: ...}",
            )
        scenes[scene.label] = scene
    return tuple(scenes.values())


def _change(node: Node) -> Change:
    if isinstance(node.content, str):
        path = node.content if "/" in node.content else f"${{{DATA}}}/{node.content}"
        return Change("scene.path", Node(path, node.place))
    if not isinstance(node.content, dict):
        raise PipelineError(
            f"a scene is a name, a path or a loader, not {node.kind}",
            where=str(node.place),
            fix="write for example llff_fern, ./photos, or {use: procedural}",
        )
    return Change("scene", node)


def _label(node: Node) -> str:
    """The loader's name if it has one, else the last part of its path, else which loader it is."""
    if isinstance(node.content, str):
        return PurePath(node.content).name
    content = node.content if isinstance(node.content, dict) else {}
    path = content.get("path")
    if "name" not in content and path is not None and isinstance(path.content, str):
        return PurePath(path.content).name
    return (item_names(node) or ["scene"])[0]
