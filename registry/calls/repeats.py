"""Repeat a call into a component on a copy of it, and compare the answers bit by bit."""

from __future__ import annotations

import copy
import hashlib
import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from torch import Generator, Tensor

from core_rasterizer import GaussianModel, GaussianReader

from ..contract.prior import Prior
from ..contract.step import Step
from ..errors import PluginError
from .process_state import own_random_numbers


def answer_of(
    component: Any,
    method: str,
    given: tuple[Any, ...],
    repeat_within: float | None = None,
    *,
    again: tuple[Any, ...] | None = None,
) -> Any:
    """Return a component's answer to a call.

    Args:
        given: the arguments.
        repeat_within: repeat the call on a copy of the component (`copy.deepcopy`), and compare, if the first
            took at most so many seconds; None: do not. If the component cannot be copied, or its copy fails,
            nothing is compared.
        again: the arguments for the copy; None: the same.

    Raises:
        PluginError: the answers differ.
    """
    if repeat_within is None:
        return getattr(component, method)(*given)
    duplicate, before = _copy_of(component, given)
    began = time.monotonic()
    answer = getattr(component, method)(*given)
    if duplicate is None or time.monotonic() - began > repeat_within:
        return answer
    after, path = [(generator, generator.get_state()) for generator, _ in before], None
    shown = logging.root.manager.disable
    # Python reuses the addresses of freed objects: without these, an answer that holds an id() could repeat.
    _occupied = [object() for _ in range(64)]
    time.sleep(0.001)  # so that two readings of a clock do not round to one answer
    try:
        logging.disable()
        for generator, state in before:
            generator.set_state(state)
        with own_random_numbers(component.context.seed):
            path = first_difference(answer, getattr(duplicate, method)(*(again or given)))
    except Exception:  # it cannot be repeated
        return answer
    finally:
        logging.disable(shown)
        for generator, state in after:
            generator.set_state(state)
    if path is not None and not is_record(path):
        raise PluginError(
            f"it gave another answer when the same call was repeated{path and f' ({path})'}: no run could "
            "be repeated or resumed",
            fix="use neither time, id() nor generators without a seed: draw from self.generator, and keep "
            "what changes between calls in attributes",
        )
    return answer


def _copy_of(component: Any, given: tuple[Any, ...]) -> tuple[Any, list[tuple[Generator, Tensor]]]:
    """Return a copy that shares the arguments, or None, and the states of generators of priors in them."""
    shared = [component.context, component.settings, *given]
    priors = [v for value in given if isinstance(value, Mapping) for v in value.values()]
    for step in given:
        if isinstance(step, Step):
            shared += [step.scene, *step.scene.train, *step.maps.values()]
            priors += step.priors.values()
    states = [(prior.generator, prior.generator.get_state()) for prior in priors]
    with suppress(Exception):
        return copy.deepcopy(component, {id(value): value for value in [*shared, *priors]}), states
    return None, states


def is_record(path: str) -> bool:
    """Whether a part of an answer may differ: it does not change the Gaussians, and facts may be seconds."""
    return path.startswith(("facts", "pictures"))


def first_difference(first: Any, second: Any) -> str | None:
    """Return the path of the first part in which two values differ by a bit; None if they are equal.

    Compares tensors, numbers, text, and dataclasses, mappings and sequences of them.
    """
    if is_dataclass(first) and type(first) is type(second):
        both = {
            field.name: [getattr(v, field.name) for v in (first, second)] for field in fields(first)
        }
        first, second = ({n: v[i] for n, v in both.items() if v[0] is not v[1]} for i in range(2))
    one, other = digests(first), digests(second)
    return next((name for name in one | other if one.get(name) != other.get(name)), None)


def digests(value: Any) -> dict[str, str]:
    """Return a digest of every part of a value, by its path."""
    return dict(_digests("", value))


def _digests(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the path and a digest of every mutable part of a value; of a folder, every file."""
    if isinstance(value, Tensor):
        content = value.detach().cpu().contiguous().numpy().tobytes()
        yield name, f"{value.dtype}{tuple(value.shape)}{_digest(content)}"
    elif isinstance(value, GaussianReader | GaussianModel):
        yield name, value.digest()
    elif isinstance(value, Path):
        for file in sorted(value.rglob("*")) if value.is_dir() else [value]:
            if file.is_file():
                path = file.relative_to(value.parent)
                yield f"{name}: the file {path}", _digest(file.read_bytes())
    elif isinstance(value, Prior):
        return
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _digests(f"{name}.{key}".lstrip("."), inner)
        yield f"{name} (its names)", repr(sorted(map(str, value)))
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _digests(f"{name}[{index}]", inner)
        yield f"{name} (its length)", repr(len(value))
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if not field.name.startswith("_"):
                yield from _digests(f"{name}.{field.name}", getattr(value, field.name))
        if isinstance(value, Step):
            yield from _digests(f"{name}.made", value.made)
            with suppress(PluginError):  # not declared, or not rendered yet
                yield from _digests(f"{name}.others", value.others)
            with suppress(PluginError):
                yield from _digests(f"{name}.rendering", value.rendering)
    elif isinstance(value, bytes):
        yield name, _digest(value)
    elif isinstance(value, str | int | float | None):
        yield name, repr(value)


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()
