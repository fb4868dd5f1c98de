"""What the command line says about an ablation, in place of what its file says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from registry.errors import PipelineError
from registry.pipeline import Node, Place, apply_override, parse

from .description import Description, Toggle, seed_count
from .variations import Variation, values


def with_arguments(
    description: Description,
    *,
    overrides: Sequence[str],
    toggles: str | None,
    vary: Sequence[str],
    scenes: str | None,
    seeds: int | None,
) -> Description:
    """The description with what the command line gives in place of what the file says.

    Args:
        overrides: changes of the pipeline itself, as for `--set`; made in its tree.
        toggles: names by commas.
        vary: each `a.b=value,value`.
        scenes: names or paths by commas.

    Raises:
        PipelineError: something empty or malformed, a setting varied twice.
    """
    for text in overrides:
        apply_override(description.pipeline, text)
    if toggles is not None:
        place = Place(f"--toggle {toggles}")
        chosen = tuple(Toggle(name, place) for name in _names(toggles, place))
        description = replace(description, toggles=chosen)
    if vary:
        description = replace(description, variations=_variations_of(vary))
    if scenes is not None:
        place = Place(f"--scenes {scenes}")
        nodes = tuple(Node(name, place) for name in _names(scenes, place))
        description = replace(description, scenes=nodes)
    if seeds is not None:
        description = replace(description, seeds=seed_count(Node(seeds, Place(f"--seeds {seeds}"))))
    return description


def _variations_of(texts: Sequence[str]) -> tuple[Variation, ...]:
    found: dict[str, Variation] = {}
    for text in texts:
        variation = _variation(text)
        if variation.name in found:
            raise PipelineError(
                f"{variation.name} is varied twice",
                where=f"--vary {text}",
                fix="give all values at once, separated by commas",
            )
        found[variation.name] = variation
    return tuple(found.values())


def _variation(text: str) -> Variation:
    place = Place(f"--vary {text}")
    path, separator, written = text.partition("=")
    if not separator or not path.strip():
        raise PipelineError(
            "a variation must look like a.b=value,value",
            where=str(place),
            fix="for example --vary opacity.base=0.98,0.99",
        )
    return values(path.strip(), parse(f"[{written}]", place.source, has_lines=False))


def _names(text: str, place: Place) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise PipelineError(
            "there is an empty name", where=str(place), fix="separate names by single commas"
        )
    return names
