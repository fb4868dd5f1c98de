"""Whether an answer holds, and whether two are the same."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor


def require(holds: bool, message: str) -> None:
    """Fail with the message unless something holds.

    Raises:
        AssertionError: it does not.
    """
    if not holds:
        raise AssertionError(message)


def require_files(files: Any) -> None:
    """Fail unless these are files that were written."""
    require(isinstance(files, list), "the answer is not a list of the files written")
    for file in files:
        require(Path(file).is_file(), f"the file {file} was not written")


def same(first: Any, second: Any) -> bool:
    """Whether two answers are equal to the last bit, tensors and containers of them too."""
    if isinstance(first, Tensor) and isinstance(second, Tensor):
        return (
            first.dtype == second.dtype
            and first.shape == second.shape
            and first.detach().cpu().numpy().tobytes() == second.detach().cpu().numpy().tobytes()
        )
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return bool(first == second)


def first_difference(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> str | None:
    """The first name under which two sets of tensors are not equal to the last bit; None if none is."""
    for name in (*one, *(name for name in other if name not in one)):
        if name not in one or name not in other or not same(one[name], other[name]):
            return name
    return None
