"""`stereogs plugins`."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path

import pytest

from tests.host import main
from tests.registry.conftest import Install

Capture = pytest.CaptureFixture[str]


def test_plugins_are_listed(pipeline: Path, capsys: Capture) -> None:
    assert main(["plugins", "--check"]) == 0
    assert "11 components, no fault" in capsys.readouterr().out
    assert main(["plugins", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    term = next(p for p in listed["plugins"] if p["name"] == "toy_term")
    assert (term["section"], term["package"], term["version"]) == ("regularizers", "toys", "1.5")
    assert term["hook"] == "stereogs_register_regularizers"
    assert term["settings"]["properties"]["target"]["default"] == 0.5
    assert listed["faults"] == []


def test_the_list_fits_a_terminal(
    pipeline: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["plugins"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "regularizers" in [line.strip() for line in lines]
    assert [line for line in lines if line.startswith("  toy_dropout  ")]


def test_the_docstring_of_a_module_can_give_the_summary(install: Install, capsys: Capture) -> None:
    code = """
    \"\"\"`slow_fade`: what is seldom seen
    fades.

    More.
    \"\"\"
    import registry
    class SlowFade(registry.Modifier[registry.Settings]):
        \"\"\"alpha <- alpha / 2.\"\"\"
        def opacity_scale(self, step): ...
    @registry.hookimpl
    def stereogs_register_modifiers(register):
        register("slow_fade", SlowFade)
    """
    install("fades", "1", {"slow_fade": "fades"}, fades=textwrap.dedent(code).strip())
    assert main(["plugins"]) == 0
    assert "slow_fade  what is seldom seen fades.\n" in capsys.readouterr().out
    assert main(["plugins", "slow_fade"]) == 0
    assert "\nwhat is seldom seen fades.\n\nalpha <- alpha / 2.\n" in capsys.readouterr().out


def test_one_component_is_shown(pipeline: Path, capsys: Capture) -> None:
    assert main(["plugins", "toy_term"]) == 0
    output = capsys.readouterr().out
    for text in ("toy_term: regularizer (toys 1.5)", "  target = 0.5", "weight"):
        assert text in output
    assert main(["plugins", "toy_term"]) == 0
    assert capsys.readouterr().out == output
    assert main(["plugins", "toy_trem"]) == 2
    assert "did you mean 'toy_term'" in capsys.readouterr().err


def test_the_settings_of_training_are_shown(capsys: Capture) -> None:
    assert main(["plugins", "training"]) == 0
    output = capsys.readouterr().out
    assert "  iterations = 30000\n      Each renders one training view." in output
    assert "  learning_rates:\n" in output
    assert "  learning_rates.opacity = 0.05\n      Of the opacity logits.\n" in output


def test_a_broken_plugin_is_reported_and_fails_the_check(
    pipeline: Path, install: Install, capsys: Capture
) -> None:
    install("wreck", "0.2", {"wreck": "wreck_module"}, wreck_module="import nothing_like_this")
    assert main(["plugins"]) == 0
    assert "wreck (wreck 0.2) cannot be used" in capsys.readouterr().out
    assert main(["plugins", "--check"]) == 1
    assert main(["plugins", "--json", "--check"]) == 1
