"""Files with any content are read, or refused with an explained error."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pydantic
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from core_rasterizer import ExplainedError, load_ply, load_points
from registry import SceneError, validate
from registry.runs import read_results
from registry.testing import tiny_scene
from registry.toolkit.photos import Decoder, Finite, read_array, read_arrays, read_document
from tests.host import (
    Failure,
    PipelineError,
    Plugins,
    Results,
    RunFolder,
    SceneRecord,
    check_content,
    escape_variables,
    is_plain_name,
    jsonable,
    parse_pipeline,
    parse_yaml,
    plain,
    to_yaml,
)
from tests.registry.conftest import TOYS

quick = settings(
    max_examples=40,
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
        value = plain(parse_yaml(text, "a.yaml"))
        assert repr(plain(parse_yaml(to_yaml(escape_variables(value)), "b.yaml"))) == repr(value)


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


HOSTILE = st.one_of(
    st.text(max_size=20),
    st.sampled_from(["\x1b[31m", "\u202e", "\udc80", "\u2028", "a\rb", "\xa0", "\x00", ""]),
)


@quick
@given(HOSTILE, HOSTILE)
def test_the_host_reads_what_it_writes(tmp_path: Path, text: str, name: str) -> None:
    """Texts of components, of photographs and of the command line may hold any character."""
    folder = RunFolder(tmp_path)
    initial = {"a": text, "numbers": [float("inf")]}
    results = Results(scene=SceneRecord(name="s", facts=jsonable({"fact": text})))
    error = ExplainedError(text, where=name, fix=text)
    results.failures = [Failure.of("metrics.psnr", error)]
    results.unavailable = {"psnr": text}
    results.initialization = jsonable(initial)
    folder.write_results(results)
    assert read_results(tmp_path / "results.json") == folder.results()
    folder.write_initialization(initial, {})
    assert len(folder.initialization()) == len(initial)


@quick
@given(HOSTILE)
def test_names_of_pipelines_and_scenes_are_validated_before_training(name: str) -> None:
    scene = replace(tiny_scene(), name=name)
    text = to_yaml({"name": name, "scene": "toy_scene", "initializer": "toy_points"})
    for read, error in (
        (lambda: validate(scene), SceneError),
        (lambda: parse_pipeline(text, Plugins(TOYS)), PipelineError),
    ):
        if is_plain_name(name):
            read()
        else:
            with pytest.raises(error):
                read()
