"""The changes are those of code, and the listed equivalents are still there."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.areas import AREAS, ROOT
from tests.mutants.equivalent import EQUIVALENT
from tests.mutants.mutations import mutants


@pytest.mark.parametrize(
    ("name", "line", "changed"),
    [
        ("a.py", "n += 2 * k  # 3 + 4", {"n -= 2 * k", "n += 2 / k", "n += 3 * k", "pass"}),
        ("a.py", "n = f(a, b) < '1 < 2'", {"n = f(b, a) < '1 < 2'", "n = f(a, b) <= '1 < 2'"}),
        ("a.py", "n: int | None = any(k)", {"n: int | None = all(k)"}),
        ("a.py", "raise ValueError(1 + 2)", set()),
        ("a.cl", "n = 0.5f; /* 1 < 2 */", {"n = 10 * 0.5f;"}),
        ("a.cl", "barrier(FENCE);", {";"}),
    ],
)
def test_code_is_changed_and_texts_are_not(
    tmp_path: Path, name: str, line: str, changed: set[str]
) -> None:
    (tmp_path / name).write_text(f"if a:\n    {line}\n")
    found = [
        mutant.new.split("  #")[0].split(" /*")[0].strip() for mutant in mutants(tmp_path, name)
    ]
    assert sorted(found) == sorted(changed)


def test_all_areas_have_files_with_tests_that_exist() -> None:
    for area in AREAS.values():
        files = dict(area.files())
        assert all((ROOT / test).is_file() for tests in files.values() for test in tests)
        assert set(area.tests) <= set(files)


def test_the_equivalents_are_mutants_of_the_code() -> None:
    known = {mutant.key for file, _, _ in EQUIVALENT for mutant in mutants(ROOT, file)}
    assert set(EQUIVALENT) <= known
