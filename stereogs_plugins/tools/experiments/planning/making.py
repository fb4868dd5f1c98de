"""From a description to a plan: every combination, on every scene, with every seed, checked."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace

from registry.errors import PipelineError
from registry.pipeline import Node, Pipeline, Place, set_value
from registry.pipeline import checked_pipeline as build_pipeline
from registry.plugins import Plugins

from .description import Description
from .plan import Combination, Plan, PlannedRun
from .scenes import AblatedScene, find_scenes
from .toggles import Switch, find_switches
from .variations import Change, Variation

SEED = "training.seed"
_NAME_LENGTH = 100


def make_plan(description: Description, plugins: Plugins) -> Plan:
    """Look everything up in the pipeline and check every combination before anything runs.

    Rows begin with everything off, then one part on, then two, as in tables of papers; within, values
    in the order written. A value of something that is off has no effect: it makes no row of its own.
    The seeds are the pipeline's and those that follow it.

    Raises:
        PipelineError: nothing to toggle or vary, unknown names, values that a component refuses, or
            two combinations that are the same pipeline.
        PluginError: a component cannot be loaded.
    """
    if not description.toggles and not description.variations:
        raise PipelineError(
            "there is nothing to toggle and nothing to vary",
            where=str(description.pipeline.place.source),
            fix="give --toggle NAME or --vary a.b=value,value, or an ablation file",
        )
    base = build_pipeline(deepcopy(description.pipeline), plugins)
    switches = find_switches(description.pipeline, base, description.toggles)
    _check_seeds_are_free(description.variations)
    scenes = find_scenes(description.pipeline, description.scenes)
    seeds = tuple(range(base.training.seed, base.training.seed + description.seeds))
    combinations = tuple(_combinations(switches, description.variations))
    plan = Plan(
        description.name,
        tuple(switch.name for switch in switches),
        description.variations,
        tuple(scene.label for scene in scenes),
        seeds,
        combinations,
        (),
    )
    return with_runs(
        plan,
        scenes,
        lambda combination, scene, seed: _pipeline(
            description.pipeline, switches, combination, scene, seed, plugins
        ),
    )


def with_runs(
    plan: Plan,
    scenes: Sequence[AblatedScene],
    pipeline_of: Callable[[Combination, AblatedScene, int], Pipeline],
) -> Plan:
    """A plan with a run for each combination, scene and seed.

    Args:
        plan: without runs.
        scenes: those that it names.
        pipeline_of: what is trained.

    Raises:
        PipelineError: two combinations are the same pipeline.
    """
    runs: dict[str, PlannedRun] = {}
    for combination, scene, seed in itertools.product(plan.combinations, scenes, plan.seeds):
        pipeline = pipeline_of(combination, scene, seed)
        digest = pipeline_digest(pipeline)
        if digest in runs:
            raise _same(plan, runs[digest], combination, scene.label)
        name = _folder_name(plan, combination, scene.label, seed, digest)
        runs[digest] = PlannedRun(combination, scene.label, seed, pipeline, digest, name)
    return replace(plan, runs=tuple(runs.values()))


def pipeline_digest(pipeline: Pipeline) -> str:
    """Ten hexadecimal digits of a hash over the complete pipeline."""
    return hashlib.sha256(pipeline.to_yaml().encode()).hexdigest()[:10]


def _check_seeds_are_free(variations: tuple[Variation, ...]) -> None:
    choices = (choice for variation in variations for choice in variation.choices)
    for change in (change for choice in choices for change in choice.changes):
        if change.path == SEED:
            raise PipelineError(
                "the seed is not varied like a setting",
                where=str(change.value.place),
                fix="say how many seeds: --seeds N, or `seeds: N` in an ablation file",
            )


def _combinations(
    switches: tuple[Switch, ...], variations: tuple[Variation, ...]
) -> Iterator[Combination]:
    count = len(switches)
    for number in range(count + 1):
        for chosen in itertools.combinations(range(count), number):
            on = tuple(index in chosen for index in range(count))
            off = _targets_off(switches, on)
            choices = (
                (None,) if _without_effect(variation, off) else variation.choices
                for variation in variations
            )
            yield from (Combination(on, picked) for picked in itertools.product(*choices))


def _targets_off(switches: tuple[Switch, ...], on: tuple[bool, ...]) -> list[str]:
    return [switch.target for switch, is_on in zip(switches, on, strict=True) if not is_on]


def _without_effect(variation: Variation, off: list[str]) -> bool:
    """Whether all that it changes is switched off."""
    return all(_is_off(change, off) for choice in variation.choices for change in choice.changes)


def _is_off(change: Change, off: list[str]) -> bool:
    return any(change.within(target) for target in off)


def _pipeline(
    root: Node,
    switches: tuple[Switch, ...],
    combination: Combination,
    scene: AblatedScene,
    seed: int,
    plugins: Plugins,
) -> Pipeline:
    off = _targets_off(switches, combination.on)
    changes = [] if scene.change is None else [scene.change]
    for choice in combination.choices:
        if choice is not None:
            changes += [change for change in choice.changes if not _is_off(change, off)]
    changes += [
        switch.off for switch, is_on in zip(switches, combination.on, strict=True) if not is_on
    ]
    return changed(root, changes, seed, plugins)


def changed(root: Node, changes: Sequence[Change], seed: int, plugins: Plugins) -> Pipeline:
    """The pipeline of a tree, which is left as it is, with changes made in order and a seed."""
    tree = deepcopy(root)
    seeded = Change(SEED, Node(seed, Place(f"seed {seed} of those to train with")))
    for change in (*changes, seeded):
        set_value(tree, change.path, deepcopy(change.value), change.value.place)
    return build_pipeline(tree, plugins)


def _same(plan: Plan, first: PlannedRun, second: Combination, scene: str) -> PipelineError:
    return PipelineError(
        f"two combinations are the same pipeline: ({plan.describe(first.combination)}, "
        f"scene {first.scene}) and ({plan.describe(second)}, scene {scene})",
        where=plan.name,
        fix="leave out the toggle, value or scene that changes nothing",
    )


def _folder_name(plan: Plan, combination: Combination, scene: str, seed: int, digest: str) -> str:
    """For people: scene and seed, what is on, the values, as far as there is room; then the digest."""
    parts = [scene, f"seed-{seed}"]
    parts += [name for name, on in zip(plan.toggles, combination.on, strict=True) if on]
    parts += ["all-off"] if plan.toggles and not any(combination.on) else []
    for variation, choice in zip(plan.variations, combination.choices, strict=True):
        parts += [f"{variation.name.split('.')[-1]}-{choice.label}"] if choice else []
    words = [re.sub(r"[^A-Za-z0-9.-]+", "-", part).strip("-.") for part in parts]
    return f"{'_'.join(words)[:_NAME_LENGTH].rstrip('_-.')}_{digest}"
