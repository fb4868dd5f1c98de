"""Files with any content are read, or refused with an explained error."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import pydantic
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from core_rasterizer import ExplainedError, load_ply, load_points
from registry.pipeline.settings_check import escape_variables, plain
from registry.pipeline.yaml_source import parse, to_yaml
from registry.runs.results import read_results
from registry.toolkit.networks.model_file import check_content
from registry.toolkit.photos import Decoder, Finite, read_array, read_arrays, read_document

quick = settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NUMBERS = st.one_of(st.integers(), st.floats(), st.booleans(), st.none())
VALUES = st.recursive(
    st.one_of(NUMBERS, st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=6,
)
FIELDS = st.sampled_from(
    ["pipeline", "scene", "test", "train", "views", "metrics", "gaussians", "hash", "unavailable"]
)
YAML_TEXTS = st.text(st.sampled_from("ab01.-:#?&*!|>'\"%@`[]{}, \n\t$\\u"), max_size=40)
MAGIC = st.sampled_from(
    [
        b"",
        b"ply\nformat ascii 1.0\n",
        b"\x93NUMPY\x01\x00v\x00{",
        b"PK\x03\x04",
        b"\x89PNG\r\n\x1a\n",
    ]
)


class Document(pydantic.BaseModel):
    number: Finite = 0.0
    names: tuple[str, ...] = ()


@quick
@given(content=st.dictionaries(FIELDS, VALUES, max_size=4))
def test_results_of_any_content(content: dict[str, object], tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps(content), "utf-8")
    with suppress(ExplainedError):
        assert read_results(path) == content


@quick
@given(content=st.one_of(VALUES, st.fixed_dictionaries({"number": VALUES, "names": VALUES})))
def test_documents_of_any_content(content: object, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(content), "utf-8")
    with suppress(ExplainedError):
        assert -float("inf") < read_document(path, Document, "").number < float("inf")


@quick
@given(text=YAML_TEXTS)
def test_yaml_of_any_text(text: str) -> None:
    with suppress(ExplainedError):
        value = plain(parse(text, "a.yaml"))
        assert repr(plain(parse(to_yaml(escape_variables(value)), "b.yaml"))) == repr(value)


@quick
@given(start=MAGIC, rest=st.binary(max_size=120))
def test_files_of_any_bytes(start: bytes, rest: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(start + rest)
    for read in (
        load_ply,
        load_points,
        Decoder().read,
        lambda path: read_array(path, "it", ""),
        lambda path: read_arrays(path, ["a"], "it", ""),
        lambda path: check_content(path.read_bytes(), path),
    ):
        with suppress(ExplainedError):
            read(path)
