"""What to ablate, as an ablation file says it; a pipeline file alone is one that changes nothing.

pipeline: ../stereogs.yaml        beside the ablation file
toggles:
  stereo_depth:                   off: disabled
  initializer: {off: sfm}         off: this component in its place
vary:
  opacity.base: [0.98, 0.99]      a list: values of a setting
  model:                          a mapping: alternatives, each a mapping of settings
    none: {regularizers.stereo_depth.enabled: false}
    small: {priors.stereo.path: small.onnx}
scenes: [llff_fern, {use: procedural}]
seeds: 3
runner: {use: ray}                where the runs are trained; without it in processes of this machine
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from registry.errors import PipelineError
from registry.messages import did_you_mean, listing
from registry.pipeline import TOP_LEVEL, Node, Place, find_pipeline, plain, read

from .variations import Variation, alternatives, values

KEYS = ("pipeline", "toggles", "vary", "scenes", "seeds", "runner")
"""The keys of an ablation file."""


@dataclass(frozen=True)
class Toggle:
    """A part of the pipeline that is switched on and off.

    Args:
        name: a section that holds one component, or a component of a list.
        place: where it was written.
        off: the component that takes its place when off; None: see toggles.py.
    """

    name: str
    place: Place
    off: Node | None = None


@dataclass(frozen=True)
class Description:
    """An ablation before anything is looked up in its pipeline.

    Args:
        name: for titles and the output folder.
        pipeline: the tree of the pipeline file; "on" means as it says.
        toggles, variations: what changes from combination to combination.
        scenes: texts or mappings, see scenes.py; empty means the pipeline's own scene.
        seeds: how many, >= 1.
        runner: who trains them, as a pipeline writes a component; None: processes of this machine.
    """

    name: str
    pipeline: Node
    toggles: tuple[Toggle, ...] = ()
    variations: tuple[Variation, ...] = ()
    scenes: tuple[Node, ...] = ()
    seeds: int = 1
    runner: Node | None = None


def read_description(path: Path, pipeline: Path | None = None) -> Description:
    """Read an ablation file, or a pipeline file, which alone toggles and varies nothing.

    Args:
        path: of the file, or the name of a ready one, such as `ablations/parts`.
        pipeline: takes the place of the file's own pipeline; a path or a name.

    Raises:
        PipelineError: a file that cannot be read, unknown keys, wrong types, nothing in a list.
    """
    path = find_pipeline(path)
    root = read(path)
    keys = root.content if isinstance(root.content, dict) else {}
    if not any(key in KEYS for key in keys):
        if pipeline is not None:
            raise PipelineError(
                "a pipeline file cannot be given another pipeline",
                where=str(path),
                fix="give --pipeline with an ablation file, or one pipeline file alone",
            )
        return Description(path.stem, root)
    for key, node in keys.items():
        if key not in KEYS:
            hint = f"; {key} belongs into the pipeline file" if key in TOP_LEVEL else ""
            raise PipelineError(
                f"an ablation has no key {key!r}{hint or did_you_mean(key, KEYS)}",
                where=str(node.place),
                fix=f"keys: {listing(KEYS)}",
            )
    return Description(
        path.stem,
        read(
            find_pipeline(pipeline)
            if pipeline
            else _pipeline_path(keys.get("pipeline"), path, root.place)
        ),
        _toggles(keys.get("toggles")),
        _variations(keys.get("vary")),
        written_scenes(keys.get("scenes")),
        seed_count(keys.get("seeds")),
        keys.get("runner"),
    )


def _pipeline_path(node: Node | None, path: Path, start: Place) -> Path:
    written = plain(node) if node else None
    if not isinstance(written, str):
        raise PipelineError(
            "the ablation does not say which pipeline it is about",
            where=str(node.place if node else start),
            fix="write for example `pipeline: ../stereogs.yaml`, a path beside this file",
        )
    return path.parent / written


def _toggles(node: Node | None) -> tuple[Toggle, ...]:
    return tuple(_toggle(name, child) for name, child in _mapping(node, "toggles"))


def _toggle(name: str, node: Node) -> Toggle:
    if node.content is None:
        return Toggle(name, node.place)
    if not isinstance(node.content, dict) or list(node.content) not in ([], ["off"]):
        found = listing(node.content) if isinstance(node.content, dict) else node.kind
        raise PipelineError(
            f"the toggle {name!r} must be empty or say what it is when `off`, not {found}",
            where=str(node.place),
            fix=f"write `{name}:` alone, or `{name}: {{off: {{use: NAME, ...}}}}`",
        )
    off = node.content.get("off")
    if off is None or off.content is None:
        return Toggle(name, node.place)
    if not isinstance(off.content, str | dict):
        raise PipelineError(
            f"what {name!r} is when off must be a component, not {off.kind}",
            where=str(off.place),
            fix="write its name, or {use: NAME, ...}; leave `off` out to switch the part off",
        )
    return Toggle(name, node.place, off)


def _variations(node: Node | None) -> tuple[Variation, ...]:
    return tuple(
        alternatives(name, child) if isinstance(child.content, dict) else values(name, child)
        for name, child in _mapping(node, "vary")
    )


def written_scenes(node: Node | None) -> tuple[Node, ...]:
    """The scenes of a list as they are written; none if nothing is said.

    Raises:
        PipelineError: it is no list, or an empty one.
    """
    if node is None:
        return ()
    if not isinstance(node.content, list) or not node.content:
        raise PipelineError(
            f"scenes must be a list of at least one, not {node.kind}",
            where=str(node.place),
            fix="write for example `scenes: [llff_fern, llff_flower]`",
        )
    return tuple(node.content)


def seed_count(node: Node | None) -> int:
    """How many seeds; 1 if nothing is said.

    Raises:
        PipelineError: it is no whole number, or less than 1.
    """
    if node is None:
        return 1
    if not isinstance(node.content, int) or isinstance(node.content, bool) or node.content < 1:
        raise PipelineError(
            f"seeds must be how many seeds to train with, 1 or more, not {node.kind}",
            where=str(node.place),
        )
    return node.content


def _mapping(node: Node | None, key: str) -> Iterable[tuple[str, Node]]:
    if node is None:
        return ()
    if not isinstance(node.content, dict) or not node.content:
        raise PipelineError(
            f"{key} must be a mapping with at least one entry, not {node.kind}",
            where=str(node.place),
            fix=f"leave {key} out if there are none",
        )
    return node.content.items()
