"""The host names no plugin, no data set and no protocol: what it needs to know they declare."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

from tests.host import GROUP, load_protocol, protocol_names

ROOT = Path(__file__).parent.parent
FILES = sorted((ROOT / "registry").rglob("*.py"))


def entry_names(group: str) -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return {name.rpartition(".")[2] for name in project["entry-points"][group]}


PROTOCOLS = set(protocol_names())
DATA_SETS = {name.partition("-")[0] for name in PROTOCOLS}
SCENES = {scene for name in PROTOCOLS for scene in load_protocol(name).scenes}
SHIPPED = (
    entry_names(GROUP)
    | PROTOCOLS
    | DATA_SETS
    | SCENES
    | {f"{data_set}_{scene}" for data_set in DATA_SETS for scene in SCENES}
)


def strings(file: Path) -> set[str]:
    """Every text in a file's code, without the docstrings."""
    tree = ast.parse(file.read_text("utf-8"))
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone
    }


def test_the_names_are_known() -> None:
    assert {"dropout", "blender-8", "dtu", "llff_fern"} <= SHIPPED


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_no_text_is_the_name_of_something_shipped(file: Path) -> None:
    assert strings(file) & SHIPPED == set()
