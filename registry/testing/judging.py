"""Whether an answer holds, and whether two are the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
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
        return torch.equal(first, second)
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return bool(first == second)
