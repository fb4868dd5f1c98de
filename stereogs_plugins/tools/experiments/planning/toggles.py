"""What "off" means. "On" is always: as the pipeline says.

A component is disabled when off, unless it names what it takes the place of
(`Component.ablation_baseline`), or an ablation file does (`off`). What a pipeline cannot do without,
the initializer, needs one of the two.
"""

from __future__ import annotations

from dataclasses import dataclass

from registry.errors import PipelineError
from registry.messages import did_you_mean, listing
from registry.pipeline import SECTIONS, Node, Pipeline, Place, component_items, item_names, parse

from .description import Toggle
from .variations import Change


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


def find_switches(root: Node, base: Pipeline, toggles: tuple[Toggle, ...]) -> tuple[Switch, ...]:
    """Find what is toggled.

    Args:
        root: the pipeline as written.
        base: the pipeline itself.

    Raises:
        PipelineError: an unknown or ambiguous name, the same component twice, a scene, or what a
            pipeline cannot do without and nothing takes the place of.
    """
    switches: dict[str, Switch] = {}
    for toggle in toggles:
        target = _target(root, toggle)
        if target in switches:
            raise PipelineError(
                f"{target} is toggled twice", where=str(toggle.place), fix="name it once"
            )
        switches[target] = Switch(toggle.name, target, _off(toggle, target, base))
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


def _off(toggle: Toggle, target: str, base: Pipeline) -> Change:
    if toggle.off is not None:
        return Change(target, toggle.off)
    item = next((i for i in base if target in (i.qualified_name, i.point.section)), None)
    if item is not None and item.offer.component.ablation_baseline is not None:
        place = Place(f"{toggle.place} (the baseline of {target})")
        baseline = parse(item.offer.component.ablation_baseline, str(place), has_lines=False)
        beside = [other.name for other in base.items[item.point.section] if other is not item]
        if item_names(baseline)[0] not in beside:  # one that is there already stays, and suffices
            return Change(target, baseline)
    if SECTIONS[target.partition(".")[0]].required:
        raise PipelineError(
            f"nothing takes the place of the {target} where it is off",
            where=str(toggle.place),
            fix=f"say what does, in an ablation file: `toggles: {{{target}: {{off: NAME}}}}`",
        )
    return Change(f"{target}.enabled", Node(False, toggle.place))
