"""Damaged data sets: no crash, no hang, no scene that is not one.

FUZZ_FILES=100000 loads that many files of each format instead of a few.
"""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from tests.stereogs_plugins.scenes.fuzz import FORMATS, damage, fuzz

FILES = int(os.environ.get("FUZZ_FILES", "90"))


@pytest.mark.timeout(300 + FILES)
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_explained_or_harmless(name: str, tmp_path: Path) -> None:
    accepted = fuzz(name, tmp_path, FILES)
    assert 0 < accepted < FILES  # the damage is neither always fatal nor always invisible


def test_the_same_number_does_the_same_damage() -> None:
    data = bytes(range(256)) * 4
    for file in ("a.npy", "b.json"):
        assert damage(data, file, random.Random(3)) == damage(data, file, random.Random(3))
        assert any(damage(data, file, random.Random(k)) != data for k in range(3))
