"""docs/numerics.md names existing tests."""

from __future__ import annotations

import re
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parent.parent / "docs" / "numerics.md"


def test_every_named_test_exists() -> None:
    promises = re.findall(r"`(test_\w+\.py)(?:::(test_\w+))?`", PAGE.read_text("utf-8"))
    assert len(promises) > 15
    for file, function in promises:
        assert (HERE / file).exists(), file
        assert f"def {function}" in (HERE / file).read_text("utf-8"), function
