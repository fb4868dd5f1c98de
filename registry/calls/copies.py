"""Copies of scenes, views and renders, for components whose writes must not reach others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache, cached_property
from typing import Any, TypeVar

T = TypeVar("T")


def copied(value: T) -> T:
    """Return a copy that shares no tensor with `value`; each tensor is copied on first access.

    Args:
        value: a tensor, or a dataclass, mapping, list or tuple of them, nested. Other objects are shared.
    """
    return _copied(value)  # type: ignore[no-any-return]


def _copied(value: Any) -> Any:
    from torch import Tensor

    if isinstance(value, Tensor):
        return value.detach().clone()
    if isinstance(value, list | tuple) and type(value) in (list, tuple):
        return type(value)(_copied(inner) for inner in value)
    if isinstance(value, Mapping):
        return {key: _copied(inner) for key, inner in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        copy = object.__new__(_class_of_copies(type(value)))
        vars(copy)[_ORIGINAL] = value
        return copy
    return value


_ORIGINAL = "_original"


@cache
def _class_of_copies(kind: type[Any]) -> type[Any]:
    """Return a subclass of a dataclass whose fields are copied from the original on first access."""
    if hasattr(kind, _ORIGINAL):  # a copy of a copy
        return kind
    names = [field.name for field in fields(kind)]

    def field_of(name: str) -> cached_property[Any]:
        return cached_property(lambda copy: _copied(getattr(vars(copy)[_ORIGINAL], name)))

    def reduced(copy: Any) -> tuple[type[Any], tuple[Any, ...]]:
        return kind, tuple(getattr(copy, name) for name in names)  # for pickle and deepcopy

    content = {name: field_of(name) for name in names}
    own = {_ORIGINAL: None, "__module__": kind.__module__, "__reduce__": reduced}
    return type(kind.__name__, (kind,), {**content, **own})
