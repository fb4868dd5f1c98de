"""The pages for plugin authors are complete and correct."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import registry
import stereogs
from registry.testing import check
from tests.host import (
    HOOK_POINTS,
    KINDS,
    OTHER_HOOKS,
    SELECTION,
    HookPoint,
    Plugins,
    parse_pipeline,
    parse_yaml,
    validate_settings,
)

DOCS = Path(__file__).parents[2] / "docs"
TUTORIAL = (DOCS / "write_a_plugin.md").read_text("utf-8")
PAGE = (DOCS / "plugin_reference.md").read_text("utf-8")
HOOKS = (*(point.hook for point in HOOK_POINTS), *OTHER_HOOKS)
MODULES = re.findall(r"^\| `((?:registry|core_rasterizer)[a-z_.]*)` \| (.*) \|$", PAGE, re.M)


@pytest.mark.parametrize("name", HOOKS)
def test_every_hook_is_documented_with_its_arguments(name: str) -> None:
    assert f"`{name}(register)`" in PAGE


def test_the_page_documents_no_other_hook() -> None:
    assert set(re.findall(r"stereogs_register_\w+", PAGE)) == set(HOOKS)


@pytest.mark.parametrize("point", HOOK_POINTS, ids=lambda point: point.section)
def test_every_hook_point_is_documented(point: HookPoint) -> None:
    row = next(line for line in PAGE.splitlines() if f"`{point.hook}(" in line)
    assert f"`{point.base.__name__}`" in row
    (method,) = getattr(point.base, "__abstractmethods__", None) or {""}
    if method:
        arguments = list(inspect.signature(getattr(point.base, method)).parameters)[1:]
        assert f"`{method}({', '.join(arguments)})" in row
    for name in point.host_settings:
        assert f"`{name}`" in PAGE


@pytest.mark.parametrize(("module", "names"), MODULES, ids=[module for module, _ in MODULES])
def test_public_modules_provide_what_the_page_lists(module: str, names: str) -> None:
    public = importlib.import_module(module)
    missing = [name for name in re.findall(r"`(\w+)`", names) if not hasattr(public, name)]
    assert missing == []


@pytest.mark.parametrize("page", [TUTORIAL, PAGE], ids=["tutorial", "reference"])
def test_the_pages_name_only_existing_names(page: str) -> None:
    for name in sorted(set(re.findall(r"registry\.([A-Za-z_]+)", page))):
        if not hasattr(registry, name):
            importlib.import_module(f"registry.{name}")


def test_the_tutorial_lists_every_kind() -> None:
    listed = TUTORIAL.partition("The kinds\nare ")[2].partition("\n\n")[0]
    assert re.findall(r"`(\w+)`", listed.replace("(a verb of `stereogs`)", "")) == list(KINDS)


def test_the_plugin_of_the_tutorial_keeps_the_contract() -> None:
    source = re.search(r"```py\n(\"\"\"`flatten`.*?)```", TUTORIAL, re.DOTALL)
    assert source is not None
    scope: dict[str, object] = {}
    exec(source[1], scope)
    check(scope["Flatten"], minimum=0.001)  # type: ignore[arg-type]


def test_the_pipeline_of_the_tutorial_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION)
    (text,) = re.findall(r"^```yaml\n(.*?)^```", TUTORIAL, re.DOTALL | re.MULTILINE)
    assert "use: flatten, " in text
    known = text.replace("use: flatten, ", "use: parameter_l1, parameter: scales, ")
    parse_pipeline(known.replace(", minimum: 0.001", ""), Plugins())


def test_a_renamed_setting_accepts_its_former_name() -> None:
    (source,) = re.findall(r"```py\n(from typing import ClassVar\n.*?)```", PAGE, re.DOTALL)
    scope: dict[str, Any] = {"Settings": registry.Settings, "__name__": "example"}
    exec(compile(source, "page", "exec", dont_inherit=True), scope)
    for text in ("target: 0.5", "{goal: 0.5, steepness: 100}"):
        settings = validate_settings(scope["MySettings"], parse_yaml(text, "old"), "example")
        assert settings.model_dump() == {"target": 0.5}


def test_the_verb_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(SELECTION)
    (source,) = re.findall(r"```py\n(\"\"\"`count`.*?)```", PAGE, re.DOTALL)
    scope: dict[str, Any] = {"__name__": "example"}
    exec(source, scope)
    pipeline = {
        "name": "small",
        "scene": {"use": "procedural", "width": 32, "height": 24},
        "initializer": {"use": "random", "count": 50},
        "metrics": ["psnr"],
    }
    run = stereogs.train(
        stereogs.build_pipeline(pipeline, ["training.iterations=1"]),
        out=tmp_path / "run",
        progress=False,
    )
    command, parser = scope["Count"](), argparse.ArgumentParser()
    command.add_arguments(parser)
    capsys.readouterr()
    assert command.run(parser.parse_args([str(tmp_path / "run")])) == 0
    assert int(capsys.readouterr().out) == run.model.count


TYPES = PAGE.partition("## Types")[2].partition("Tensors are")[0]
EDITS = PAGE.partition("### Edits")[2].partition("## ")[0]


def public_type(name: str) -> Any:
    """A class by its name, from the module that provides it."""
    places = [module for module, names in MODULES if f"`{name}`" in names]
    places += ["stereogs.api", "core_rasterizer"]
    modules = (importlib.import_module(place) for place in places)
    return next(getattr(module, name) for module in modules if hasattr(module, name))


def fields_of(name: str) -> set[str]:
    fields = dataclasses.fields(public_type(name))
    return {field.name for field in fields if not field.name.startswith("_")}


@pytest.mark.parametrize("name", re.findall(r"`(\w+)`", TYPES))
def test_its_docstring_names_every_field(name: str) -> None:
    bases = (base for base in public_type(name).__mro__ if base is not object)
    text = " ".join(base.__doc__ or "" for base in bases)
    assert fields_of(name) <= set(re.findall(r"\w+", text))


def test_the_page_names_every_field_of_an_edit() -> None:
    assert fields_of("Edit") <= set(re.findall(r"\w+", EDITS))
