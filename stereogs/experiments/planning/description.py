"""Read an ablation from a file and the command line. A pipeline file is an ablation without changes.

pipeline: ../stereogs.yaml        relative to the ablation file
toggles:
  stereo_depth:                   off: disabled
  initializer: {off: sfm}         off: replaced by this component
vary:
  opacity.base: [0.98, 0.99]      a list: values of a setting
  model:                          a mapping: alternatives, each a mapping of settings
    none: {regularizers.stereo_depth.enabled: false}
    small: {priors.stereo.path: small.onnx}
scenes: [llff_fern, {use: procedural}]
seeds: 3
runner: {use: ray}                where to train; default: processes on this machine
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from registry.errors import PipelineError
from registry.messages.suggestions import did_you_mean, listing
from registry.pipeline.edits import TOP_LEVEL, apply_override
from registry.pipeline.ready import find_pipeline
from registry.pipeline.settings_check import plain
from registry.pipeline.yaml_source import Node, Place, parse, read

from .variations import Variation, alternatives, values

_CLOSING = {"{": "}", "[": "]", '"': '"', "'": "'"}
KEYS = ("pipeline", "toggles", "vary", "scenes", "seeds", "runner")
"""The keys of an ablation file."""


@dataclass(frozen=True)
class Toggle:
    """A part of the pipeline to switch on and off.

    Args:
        name: a section with a single component, or a component of a list.
        place: where the toggle is written.
        off: the component that replaces it when off; None: see making.py.
    """

    name: str
    place: Place
    off: Node | None = None


@dataclass(frozen=True)
class Description:
    """An ablation before it is checked against its pipeline.

    Args:
        name: for titles and the output folder.
        pipeline: the tree of the pipeline file.
        toggles, variations: the differences between combinations.
        scenes: see `scene_choices`; empty for the pipeline's own scene.
        seeds: number of seeds, >= 1.
        runner: a component that trains the runs; None for processes on this machine.
    """

    name: str
    pipeline: Node
    toggles: tuple[Toggle, ...] = ()
    variations: tuple[Variation, ...] = ()
    scenes: tuple[Node, ...] = ()
    seeds: int = 1
    runner: Node | None = None


def read_description(path: Path, pipeline: Path | None = None) -> Description:
    """Read an ablation file or a pipeline file.

    Args:
        path: a path, or the name of a ready file, such as `ablations/parts`.
        pipeline: path or name of a pipeline that replaces the ablation file's own.

    Raises:
        PipelineError: a file cannot be read, or has unknown keys, wrong types or empty lists.
    """
    path = find_pipeline(path)
    root = read(path)
    keys = root.content if isinstance(root.content, dict) else {}
    if not any(key in KEYS for key in keys):
        if pipeline is not None:
            raise PipelineError(
                "--pipeline needs an ablation file, and this is a pipeline file",
                where=str(path),
                fix="give an ablation file, or remove --pipeline",
            )
        return Description(path.stem, root)
    check_keys(keys, KEYS, "an ablation")
    if pipeline is None:
        pipeline_file = _pipeline_path(keys.get("pipeline"), path, root.place)
    else:
        pipeline_file = find_pipeline(pipeline)
    return Description(
        path.stem,
        read(pipeline_file),
        tuple(_toggle(name, child) for name, child in _mapping(keys.get("toggles"), "toggles")),
        tuple(
            alternatives(name, child) if isinstance(child.content, dict) else values(name, child)
            for name, child in _mapping(keys.get("vary"), "vary")
        ),
        scene_list(keys.get("scenes")),
        seed_count(keys.get("seeds")),
        keys.get("runner"),
    )


def check_keys(keys: dict[str, Node], known: Sequence[str], file: str) -> None:
    """Check the keys of an ablation or matrix file.

    Raises:
        PipelineError: an unknown key.
    """
    for key, node in keys.items():
        if key not in known:
            hint = f"; {key} belongs in the pipeline file" if key in TOP_LEVEL else ""
            raise PipelineError(
                f"{file} has no key {key!r}{hint or did_you_mean(key, known)}",
                where=str(node.place),
                fix=f"keys: {listing(known)}",
            )


def _pipeline_path(node: Node | None, path: Path, start: Place) -> Path:
    written = plain(node) if node else None
    if not isinstance(written, str):
        raise PipelineError(
            "the ablation file names no pipeline",
            where=str(node.place if node else start),
            fix="write for example `pipeline: ../stereogs.yaml`, a path relative to this file",
        )
    return path.parent / written


def _toggle(name: str, node: Node) -> Toggle:
    if node.content is None:
        return Toggle(name, node.place)
    if not isinstance(node.content, dict) or list(node.content) not in ([], ["off"]):
        found = listing(node.content) if isinstance(node.content, dict) else node.kind
        raise PipelineError(
            f"the toggle {name!r} must be empty or have the key `off`, not {found}",
            where=str(node.place),
            fix=f"write only `{name}:`, or `{name}: {{off: {{use: NAME, ...}}}}`",
        )
    off = node.content.get("off")
    if off is None or off.content is None:
        return Toggle(name, node.place)
    if not isinstance(off.content, str | dict):
        raise PipelineError(
            f"`off` of {name!r} must be a component, not {off.kind}",
            where=str(off.place),
            fix="write its name, or {use: NAME, ...}; remove `off` to disable the part",
        )
    return Toggle(name, node.place, off)


def scene_list(node: Node | None) -> tuple[Node, ...]:
    """Return the entries of the key `scenes`; none without the key.

    Raises:
        PipelineError: not a list, or an empty list.
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
    """Return the number of seeds; 1 by default.

    Raises:
        PipelineError: not a positive integer.
    """
    if node is None:
        return 1
    if not isinstance(node.content, int) or isinstance(node.content, bool) or node.content < 1:
        raise PipelineError(
            f"seeds must be the number of seeds, 1 or more, not {node.kind}", where=str(node.place)
        )
    return node.content


def _mapping(node: Node | None, key: str) -> Iterable[tuple[str, Node]]:
    if node is None:
        return ()
    if not isinstance(node.content, dict) or not node.content:
        raise PipelineError(
            f"{key} must be a mapping with at least one entry, not {node.kind}",
            where=str(node.place),
            fix=f"remove {key} if there are none",
        )
    return node.content.items()


def with_arguments(
    description: Description,
    *,
    overrides: Sequence[str],
    toggles: str | None,
    vary: Sequence[str],
    scenes: str | None,
    seeds: int | None,
) -> Description:
    """Return the description with parts replaced by arguments of the command line.

    Args:
        overrides: as for `--set`; change the pipeline's tree in place.
        toggles: comma-separated names.
        vary: each `a.b=value,value`.
        scenes: comma-separated names, paths, or loaders such as `{use: procedural, width: 96}`.

    Raises:
        PipelineError: an argument is empty or malformed, or a setting is varied twice.
    """
    for text in overrides:
        apply_override(description.pipeline, text)
    if toggles is not None:
        place = Place(f"--toggle {toggles}")
        chosen = tuple(Toggle(name, place) for name in _names(toggles, place))
        description = replace(description, toggles=chosen)
    if vary:
        description = replace(description, variations=_variations(vary))
    if scenes is not None:
        place = Place(f"--scenes {scenes}")
        nodes = tuple(_scene(text, place) for text in _names(scenes, place))
        description = replace(description, scenes=nodes)
    if seeds is not None:
        description = replace(description, seeds=seed_count(Node(seeds, Place(f"--seeds {seeds}"))))
    return description


def _variations(texts: Sequence[str]) -> tuple[Variation, ...]:
    found: dict[str, Variation] = {}
    for text in texts:
        path, separator, written = text.partition("=")
        path, place = path.strip(), Place(f"--vary {text}")
        if not separator or not path:
            raise PipelineError(
                "a variation must look like a.b=value,value",
                where=str(place),
                fix="for example --vary opacity.base=0.98,0.99",
            )
        if path in found:
            raise PipelineError(
                f"{path} is varied twice",
                where=str(place),
                fix="list all values in one --vary, separated by commas",
            )
        found[path] = values(path, parse(f"[{written}]", place.source, has_lines=False))
    return tuple(found.values())


def _scene(text: str, place: Place) -> Node:
    """Return a loader or a quoted name as YAML reads it; other texts as they are."""
    return parse(text, place.source, has_lines=False) if text[0] in "{\"'" else Node(text, place)


def _names(text: str, place: Place) -> list[str]:
    """Split at commas outside of braces, brackets and quotes, which count where YAML reads them."""
    parts, ends = [""], ""
    for sign in text:
        if sign == ends[-1:]:
            ends = ends[:-1]
        elif sign in _CLOSING and ends[-1:] not in ("'", '"'):
            before = parts[-1].rstrip()[-1:]
            if before in ("", *"{[,:"):  # else within a name, such as it's or a[1]
                ends += _CLOSING[sign]
        if sign == "," and not ends:
            parts.append("")
        else:
            parts[-1] += sign
    names = [name.strip() for name in parts]
    if not all(names):
        raise PipelineError(
            "there is an empty name", where=str(place), fix="separate names by single commas"
        )
    return names
