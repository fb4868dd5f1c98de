"""The plan: what is trained, in which order."""

from __future__ import annotations

from dataclasses import dataclass

from registry.pipeline import Pipeline

from .variations import Choice, Variation


@dataclass(frozen=True)
class Combination:
    """One row of the table.

    Args:
        on: for each toggle whether it is on.
        choices: for each variation its value, or None where what it varies is off.
    """

    on: tuple[bool, ...]
    choices: tuple[Choice | None, ...]


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """One training.

    Args:
        combination, scene, seed: which one it is.
        pipeline: complete and checked.
        digest: of the pipeline with every default written out; finds the run's folder again.
        name: of a new folder: a description for people, then the digest.
    """

    combination: Combination
    scene: str
    seed: int
    pipeline: Pipeline
    digest: str
    name: str


@dataclass(frozen=True)
class Plan:
    """An ablation, ready to run.

    Args:
        name: for titles.
        toggles: the names of what is switched on and off.
        variations: what is varied.
        scenes, seeds: what each combination is trained on and with.
        combinations: the rows, in order.
        runs: in order: combinations, in each the scenes, in each the seeds.
        kind: "ablation" or "bench", for titles and files.
    """

    name: str
    toggles: tuple[str, ...]
    variations: tuple[Variation, ...]
    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    combinations: tuple[Combination, ...]
    runs: tuple[PlannedRun, ...]
    kind: str = "ablation"

    @property
    def size(self) -> str:
        """The number of runs, and how it comes about."""
        factors = {
            "combination": len(self.combinations),
            "scene": len(self.scenes),
            "seed": len(self.seeds),
        }
        terms = (f"{count} {name}{'' if count == 1 else 's'}" for name, count in factors.items())
        return f"{' x '.join(terms)} = {len(self.runs)} runs"

    def describe(self, combination: Combination) -> str:
        """For messages: "stereo_depth off, opacity.base 0.99"."""
        toggles = zip(self.toggles, combination.on, strict=True)
        parts = [f"{name} {'on' if on else 'off'}" for name, on in toggles]
        for variation, choice in zip(self.variations, combination.choices, strict=True):
            parts += [f"{variation.name} {choice.label}"] if choice else []
        return ", ".join(parts)
