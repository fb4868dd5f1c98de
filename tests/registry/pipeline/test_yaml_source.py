from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from registry.pipeline.settings_check import escape_variables, plain
from registry.pipeline.yaml_source import parse, read, resolve, to_yaml
from tests.host import PipelineError


def value(text: str) -> Any:
    return plain(parse(text, "a.yaml"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        (".5", 0.5),
        ("12", 12),
        ("012", 12),
        ("-3", -3),
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("no", "no"),
        ("on", "on"),
        ("off", "off"),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("1_000", "1_000"),
        ("0x10", "0x10"),
        ("null", None),
        ("~", None),
        ("-.inf", -math.inf),
        ("'12'", "12"),
        ('"true"', "true"),
        ("1.2.3", "1.2.3"),
    ],
)
def test_plain_scalars_mean_what_they_look_like(text: str, expected: Any) -> None:
    result = value(f"key: {text}")["key"]
    assert result == expected
    assert type(result) is type(expected)


def test_keys_are_text_even_when_they_look_like_something_else() -> None:
    assert value("on: 1\n1: 2\nnull: 3") == {"on": 1, "1": 2, "null": 3}


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("a: 1\nb: 2\na: 3", 3, "written twice"),
        ("a:\n  b: 1\n  b: 1", 3, "written twice"),
        ("a: &x [1]\nb: *x", 1, "aliases"),
        ("a: 1\nb: !!python/object:os.system {}", 2, "tag"),
        ("a: 1\nb: !custom 3", 2, "tag"),
        ("a: [1, 2", 1, "not valid YAML"),
        ("a: 1\n\tb: 2", 2, "not valid YAML"),
        ("a: 1\n---\nb: 2", 2, "not valid YAML"),
        ("? [a]\n: 1", 1, "plain word"),
        ("a: " + "[" * 40 + "]" * 40, 1, "deep"),
        ("a:\n" + "- " * 3000, 2, "deep"),
        ("scene: {use: llff\n", 1, "not valid YAML"),
        ("a: 1\nb: [1\n\n", 2, "not valid YAML"),
        ("a: 'open\n", 1, "not valid YAML"),
        ("a: 1\nb: \x00", 2, r"U\+0000"),
        ('a: 1\nb: "\\U00110000"', 2, "escape"),
        ('a: 1\nb: "\\UFFFFFFFF"', 2, "escape"),
        ('a: 1\nb: "\\uD800"', 2, "surrogate"),
        ('a: 1\n"\\uD800": 2', 2, "surrogate"),
    ],
)
def test_traps_are_refused_with_their_line(text: str, line: int, message: str) -> None:
    with pytest.raises(PipelineError, match=message) as caught:
        parse(text, "a.yaml")
    assert caught.value.where == f"a.yaml:{line}"


def test_extreme_nesting_is_an_error_and_not_a_crash() -> None:
    with pytest.raises(PipelineError, match="deep"):
        parse("[" * 100_000, "a.yaml")


def test_an_unquoted_variable_in_braces_gets_a_hint() -> None:
    with pytest.raises(PipelineError) as caught:
        parse("scene: {use: llff, path: ${DATA}/x}", "a.yaml")
    assert "quotes" in caught.value.fix


@pytest.mark.parametrize("data", [b"\xff\xfea: 1", b"a: \x00", b"name: caf\xe9"])
def test_files_that_are_no_text_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(data)
    with pytest.raises(PipelineError) as caught:
        read(path)
    assert str(path) in caught.value.where


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PipelineError, match="cannot be read"):
        read(tmp_path / "none.yaml")
    with pytest.raises(PipelineError, match="cannot be read"):
        read(tmp_path)


def test_variables_are_filled_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOM", "kitchen")
    monkeypatch.delenv("HOUSE", raising=False)
    assert value("a: ${ROOM}/x\nb: '$${ROOM} $5'") == {"a": "kitchen/x", "b": "${ROOM} $5"}
    with pytest.raises(PipelineError, match="'HOUSE' is not set") as caught:
        value("a: 1\nb:\n - ${HOUSE}")
    assert caught.value.where == "a.yaml:3"


LETTERS = "aé🌿 :#'\"{}[]&*!|>%@`-?,$0189.eE~_\\\n\t\x85\u2028\ufeff"
scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(10**15), 10**15)
    | st.floats(allow_nan=False)
    | st.text(st.sampled_from(LETTERS), max_size=8)
    | st.sampled_from(["yes", "1e-3", "012", "~", "null", "${X}", "$${X}", "a: b", "- a", " a "])
)
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["a", "on", "1"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(["k", "no", "1e3"]), trees, max_size=3))
def test_what_is_written_is_read_back_unchanged(tree: dict[str, Any]) -> None:
    assert plain(parse(to_yaml(escape_variables(tree)), "a.yaml")) == tree


@given(st.text(st.sampled_from(LETTERS + "aUud0\r\x00\ud800"), max_size=14))
def test_any_text_is_read_or_refused_with_its_line(text: str) -> None:
    refusal: PipelineError | None = None
    try:
        parse(text, "a.yaml")
    except PipelineError as error:
        refusal = error
    assert refusal is None or re.fullmatch(r"a\.yaml:[1-9][0-9]*", refusal.where)


@given(st.text(st.sampled_from(LETTERS), max_size=8))
def test_every_text_has_a_meaning(text: str) -> None:
    assert resolve(text) is None or isinstance(resolve(text), str | int | float)
