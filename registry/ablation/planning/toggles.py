"""What "off" means. "On" is always: as the pipeline says.

A component of a list (a regularizer, a modifier, ...) is disabled when off, and so is the
densification. An initializer cannot be missing: it is `sfm` when off. The opacity policy is 3DGS's
periodic reset when off, which is what every policy of the literature takes the place of. An ablation
file may name another component as `off`.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...errors import PipelineError
from ...pipeline.edits import component_items, item_names
from ...pipeline.yaml_source import Node, Place, parse
from ...suggestions import did_you_mean, listing
from .description import Toggle
from .variations import Change

BASELINES = {
    "initializer": "sfm",
    "opacity": "{use: opacity_reset, every: 10%, stop: 49.9%}",
}
"""What a section's component is when off, where being without it is no baseline. 3DGS resets every
3,000 of 30,000 iterations, in their first half."""


@dataclass(frozen=True)
class Switch:
    """A toggle that was found in the pipeline.

    Args:
        name: what tables call it.
        target: the path of the component, for example "regularizers.stereo_depth".
        off: the change that switches it off.
    """

    name: str
    target: str
    off: Change


def find_switches(root: Node, toggles: tuple[Toggle, ...]) -> tuple[Switch, ...]:
    """Find what is toggled.

    Raises:
        PipelineError: an unknown or ambiguous name, the same component twice, or a scene.
    """
    switches: dict[str, Switch] = {}
    for toggle in toggles:
        target = _target(root, toggle)
        if target in switches:
            raise PipelineError(
                f"{target} is toggled twice", where=str(toggle.place), fix="name it once"
            )
        switches[target] = Switch(toggle.name, target, _off(toggle, target))
    return tuple(switches.values())


def _target(root: Node, toggle: Toggle) -> str:
    """The path of the component that a name means: its own name or, if it is single, its section."""
    if toggle.name == "scene":
        raise PipelineError(
            "a scene cannot be toggled",
            where=str(toggle.place),
            fix="give the scenes to train on with --scenes, or as `scenes:` in an ablation file",
        )
    known: dict[str, list[str]] = {}
    for section, item in component_items(root):
        if section == "scene":
            continue
        if isinstance(root.content, dict) and isinstance(root.content[section].content, list):
            name = item_names(item)[0]
            path = f"{section}.{name}"
            names = [path, name]
        else:
            path = section
            names = [section, *item_names(item)]
        for name in dict.fromkeys(names):
            known.setdefault(name, []).append(path)
    found = known.get(toggle.name, [])
    if not found:
        raise PipelineError(
            f"the pipeline has nothing named {toggle.name!r} to toggle"
            f"{did_you_mean(toggle.name, known)}",
            where=str(toggle.place),
            fix=f"what it has: {listing(name for name in known if '.' not in name)}",
        )
    if len(found) > 1:
        raise PipelineError(
            f"{toggle.name!r} means more than one thing",
            where=str(toggle.place),
            fix=f"write one of: {listing(found)}",
        )
    return found[0]


def _off(toggle: Toggle, target: str) -> Change:
    if toggle.off is not None:
        return Change(target, toggle.off)
    if target in BASELINES:
        place = Place(f"{toggle.place} (the baseline of {target})")
        return Change(target, parse(BASELINES[target], str(place), has_lines=False))
    return Change(f"{target}.enabled", Node(False, toggle.place))
