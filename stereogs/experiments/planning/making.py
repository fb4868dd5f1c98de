"""Turn an ablation into a plan.

"On" means as the pipeline specifies. "Off" disables a component, or replaces it with a baseline if the
component (`Component.ablation_baseline`) or the ablation file (`off`) names one. Required components, such as
the initializer, need a baseline.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from copy import deepcopy

from registry.discovery import Plugins
from registry.errors import PipelineError
from registry.messages.suggestions import did_you_mean, listing
from registry.pipeline.edits import SECTIONS, component_items, item_names
from registry.pipeline.pipeline import Pipeline, checked_pipeline
from registry.pipeline.yaml_source import Node, Place

from .description import Description, Toggle
from .plan import SEED, Combination, Plan, changed_pipeline, with_runs
from .variations import Alternative, Change, Variation, scene_choices

Switches = dict[str, Change]
"""For the path of each toggled component, such as "regularizers.stereo_depth", the change for "off"."""


def make_plan(description: Description, plugins: Plugins) -> Plan:
    """Find toggles and variations in the pipeline and check every combination before anything runs.

    The first row has all toggles off, followed by rows with one on, two on and so on, as in papers; values
    vary within, in the order written. If a component is off, its values make no rows. Seeds count up from the
    pipeline's own.

    Raises:
        PipelineError: nothing to toggle or vary, an unknown name, a value that a component rejects, or two
            combinations with the same pipeline.
        PluginError: a component cannot be loaded.
    """
    if not description.toggles and not description.variations:
        raise PipelineError(
            "there is nothing to toggle and nothing to vary",
            where=str(description.pipeline.place.source),
            fix="give --toggle NAME or --vary a.b=value,value, or an ablation file",
        )
    base = checked_pipeline(deepcopy(description.pipeline), plugins)
    switches = _find_switches(description.pipeline, base, description.toggles)
    _check_seed_is_not_varied(description.variations)
    scenes = scene_choices(description.pipeline, description.scenes)

    def pipeline(combination: Combination, scene: Alternative, seed: int) -> Pipeline:
        off = _off(switches, combination.on)
        changes = [
            change
            for choice in combination.choices
            for change in (choice.changes if choice else ())
            if not _is_off(change, off)
        ]
        changes = [*scene.changes, *changes, *off.values()]
        return changed_pipeline(description.pipeline, changes, seed, plugins)

    plan = Plan(
        description.name,
        tuple(toggle.name for toggle in description.toggles),
        description.variations,
        tuple(scene.label for scene in scenes),
        tuple(range(base.training.seed, base.training.seed + description.seeds)),
        tuple(_combinations(switches, description.variations)),
    )
    return with_runs(plan, scenes, pipeline)


def _check_seed_is_not_varied(variations: tuple[Variation, ...]) -> None:
    choices = (choice for variation in variations for choice in variation.choices)
    for change in (change for choice in choices for change in choice.changes):
        if change.path == SEED:
            raise PipelineError(
                "the seed cannot be varied like a setting",
                where=str(change.value.place),
                fix="give the number of seeds: --seeds N, or `seeds: N` in an ablation file",
            )


def _combinations(switches: Switches, variations: tuple[Variation, ...]) -> Iterator[Combination]:
    count = len(switches)
    for number in range(count + 1):
        for chosen in itertools.combinations(range(count), number):
            on = tuple(index in chosen for index in range(count))
            off = _off(switches, on)
            choices = (
                (None,) if _has_no_effect(variation, off) else variation.choices
                for variation in variations
            )
            yield from (Combination(on, picked) for picked in itertools.product(*choices))


def _off(switches: Switches, on: tuple[bool, ...]) -> Switches:
    switched = zip(switches.items(), on, strict=True)
    return {target: change for (target, change), is_on in switched if not is_on}


def _is_off(change: Change, off: Switches) -> bool:
    return any(change.within(target) for target in off)


def _has_no_effect(variation: Variation, off: Switches) -> bool:
    return all(_is_off(change, off) for choice in variation.choices for change in choice.changes)


def _find_switches(root: Node, base: Pipeline, toggles: tuple[Toggle, ...]) -> Switches:
    """Find the toggled components in the tree `root` of the pipeline `base`."""
    switches: Switches = {}
    for toggle in toggles:
        target = _target(root, toggle)
        if target in switches:
            raise PipelineError(
                f"{target} is toggled twice", where=str(toggle.place), fix="name it once"
            )
        switches[target] = _switched_off(toggle, target, base)
    return switches


def _target(root: Node, toggle: Toggle) -> str:
    """Return the path of the component with this name, or the section with this single component."""
    if toggle.name == "scene":
        raise PipelineError(
            "a scene cannot be toggled",
            where=str(toggle.place),
            fix="list the scenes with --scenes, or as `scenes:` in an ablation file",
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
            f"the pipeline has no component {toggle.name!r}{did_you_mean(toggle.name, known)}",
            where=str(toggle.place),
            fix=f"components: {listing(name for name in known if '.' not in name)}",
        )
    if len(found) > 1:
        raise PipelineError(
            f"{toggle.name!r} is ambiguous",
            where=str(toggle.place),
            fix=f"write one of: {listing(found)}",
        )
    return found[0]


def _switched_off(toggle: Toggle, target: str, base: Pipeline) -> Change:
    """Return the change that switches a component off."""
    if toggle.off is not None:
        return Change(target, toggle.off)
    item = next((i for i in base if target in (i.qualified_name, i.point.section)), None)
    baseline = item.offer.component.ablation_baseline if item else None
    if item is not None and baseline is not None:
        others = [other.name for other in base.items[item.point.section] if other is not item]
        if baseline not in others:
            place = Place(f"{toggle.place} (the baseline of {target})")
            return Change(target, Node(baseline, place))
    if SECTIONS[target.partition(".")[0]].required:
        raise PipelineError(
            f"the {target} is required and has no baseline to replace it when off",
            where=str(toggle.place),
            fix=f"set one in an ablation file: `toggles: {{{target}: {{off: NAME}}}}`",
        )
    return Change(f"{target}.enabled", Node(False, toggle.place))
