"""Errors of faulty plugins name the plugin and do not affect others.

Tests of `registry.calls`, which import its modules.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import stereogs
from core_rasterizer import Device, ExplainedError
from registry import PluginError
from registry.calls.memory import MemoryLedger
from registry.calls.watchdog import WATCHDOG
from stereogs import Pipeline
from tests.host import (
    FOLDER_VARIABLE,
    GROUP,
    Plugins,
    load_run,
    parse_pipeline,
    repeat_failure,
    resident_bytes,
)
from tests.registry.conftest import TOYS
from tests.registry.faulty import NAMES, installed, module

BASE = """\
name: faulty
scene: toy_scene
initializer: toy_points
training: {iterations: 8, sh_degree: 0, checkpoint_every: 2}
"""
AT_IMPORT = {
    "import_error": "ZeroDivisionError",
    "missing_dependency": "a_package_that_nobody_has",
    "syntax_error": "SyntaxError",
    "exit_at_import": "SystemExit: 3",
    "wrong_api": "needs stereogs API 99",
    "misspelt_hook": "did you mean 'stereogs_register_regularizers'",
}
"""Errors of plugins that cannot be loaded."""

IN_THE_LOOP = {
    "wrong_signature": "TypeError",
    "error_at_iteration": "a view that is not there",
    "exit_in_loss": "SystemExit: 0",
    "nan_loss": "the loss is not finite",
    "nan_gradient": "undefined gradient",
    "constant_loss": "has no gradient",
    "wrong_shape": "expected one floating-point number",
    "wrong_dtype": "the opacity scale is torch.int64",
    "float_loss": "the loss is a float",
    "writes_image": "it wrote into the photograph of view",
    "writes_camera": "it wrote into the camera of view2",
    "writes_points": "it wrote into the positions of the scene's points",
    "writes_step": "TypeError",
    "seeds_globally": "torch's global generator",
    "draws_globally": "torch's global generator",
    "changes_folder": "changed the working directory",
    "logs_as_host": "it logs 'loss'",
    "wrong_carry": "IndexError",
    "writes_past_torch": "it wrote into the photograph of view",
    "writes_model": "it wrote into the Gaussians",
}
"""Errors of plugins that fail in iteration 5."""

ONLY_IF_CHECKED = {
    "spoils_model": ("it wrote into the Gaussians", 6),
    "missing_carry": ("the state 'ages' has the shape (60,) after an edit", 5),
}
"""Errors that are found in an iteration if plugins are checked."""
ELSEWHERE = (
    *("hang_at_import", "builtin_name", "hangs", "leaves_thread", "unsavable_state"),
    "grows_memory",
)
AFTERWARDS = ("writes_rendering",)
PRIORS = {
    "prior_raises": "ValueError: no network",
    "prior_answers_nothing": "the answer is a NoneType",
    "prior_answers_too_few": "0 depth maps came for 2 views",
}

USES_PRIOR = EntryPoint(
    "consistency_dense", "stereogs_plugins.initializers.consistency_dense", GROUP
)
"""An initializer that uses a prior."""

Make = Callable[[str], Pipeline]


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Toys, all faulty packages, and an initializer that uses a prior."""
    return Plugins([*TOYS, USES_PRIOR, *installed(NAMES, tmp_path / "site", monkeypatch)])


@pytest.fixture
def make(plugins: Plugins) -> Make:
    """Return a function that makes a pipeline of toys; the argument begins in line 5."""
    return lambda text: parse_pipeline(BASE + text, plugins, source="p.yaml")


def component(name: str) -> str:
    """Return the pipeline's line 5, with a component that is called from iteration 5 on."""
    section = "modifiers" if name == "wrong_dtype" else "regularizers"
    growth = "densification: {use: toy_growth, prune: false, start: 5, every: 1}\n"
    return f"{section}: [{{use: {name}, start: {4 if 'carry' in name else 5}}}]\n" + (
        growth if "carry" in name else ""
    )


def refusal(pipeline: Pipeline, out: Path, device: Device, **options: object) -> ExplainedError:
    with pytest.raises(ExplainedError) as caught:
        stereogs.train(pipeline, out=out, progress=False, device=device, **options)  # type: ignore[arg-type]
    return caught.value


def blamed(error: ExplainedError, name: str, title: str = "", *, iteration: int | None = 5) -> None:
    """Check that the error names plugin, package, version, line and iteration, and has a fix."""
    assert f"{title} '{name}' (faulty-{name.replace('_', '-')} 6.6) at p.yaml:5" in error.where
    assert iteration is None or f"iteration {iteration}" in error.where
    assert error.fix


def test_all_packages_are_tested() -> None:
    tested = {*AT_IMPORT, *IN_THE_LOOP, *ONLY_IF_CHECKED, *ELSEWHERE, *AFTERWARDS, *PRIORS}
    assert tested == set(NAMES)


def test_a_pipeline_imports_only_the_plugins_that_it_names(
    make: Make, device: Device, tmp_path: Path
) -> None:
    run = stereogs.train(make(""), out=tmp_path / "run", progress=False, device=device)
    assert run.finished
    assert not {module(name) for name in NAMES} & set(sys.modules)


@pytest.mark.parametrize("name", AT_IMPORT)
def test_a_plugin_that_cannot_be_loaded_is_named_with_its_line(make: Make, name: str) -> None:
    with pytest.raises(PluginError) as caught:
        make(component(name))
    error = caught.value
    assert AT_IMPORT[name] in error.what
    assert f"{name} (faulty-{name.replace('_', '-')} 6.6)" in error.what
    assert error.where.startswith("p.yaml:5")
    assert error.fix
    others = {module(other) for other in NAMES if other != name}
    assert not others & set(sys.modules)


@pytest.mark.parametrize("name", IN_THE_LOOP)
def test_a_failure_in_the_loop_names_the_plugin_and_keeps_the_last_checkpoint(
    make: Make, plugins: Plugins, device: Device, tmp_path: Path, name: str
) -> None:
    before, out = Path.cwd(), tmp_path / "run"
    error = refusal(make(component(name)), out, device)
    assert IN_THE_LOOP[name] in error.what
    blamed(error, name)
    assert Path.cwd() == before
    assert load_run(out, plugins=plugins, device=device).iteration == 4


@pytest.mark.parametrize("name", ONLY_IF_CHECKED)
def test_hidden_writes_are_found_if_plugins_are_checked(
    make: Make, device: Device, tmp_path: Path, name: str
) -> None:
    error = refusal(make(component(name)), tmp_path / "run", device, check_plugins=True)
    what, iteration = ONLY_IF_CHECKED[name]
    assert what in error.what
    blamed(error, name, iteration=iteration)


@pytest.mark.parametrize("start", [5, 6, 8])
def test_invalid_gaussians_are_never_saved_and_replay_repeats_the_failure(
    make: Make, plugins: Plugins, device: Device, tmp_path: Path, start: int
) -> None:
    """Between checkpoints, when one is due (every second iteration), and in the last iteration."""
    out = tmp_path / "run"
    text = component("spoils_model").replace("start: 5", f"start: {start - 1}")
    error = refusal(make(text), out, device)
    assert "1 values are not finite" in error.what
    failed = min(start + 1, 8)
    assert error.where == f"log_scales[7]; iteration {failed}"
    assert load_run(out, plugins=plugins, device=device).iteration == 2 * ((start - 1) // 2)
    with pytest.raises(ExplainedError, match="not finite") as again:
        repeat_failure(out / "failures" / f"iteration-{failed:07d}", plugins=plugins, device=device)
    assert again.value.where == error.where


def test_state_that_cannot_be_saved_is_refused_before_the_first_iteration(
    make: Make, device: Device, tmp_path: Path
) -> None:
    error = refusal(make(component("unsavable_state")), tmp_path / "run", device)
    assert "the state 'seen' is a list" in error.what
    blamed(error, "unsavable_state", iteration=0)


def test_a_hang_in_the_loop_ends_with_an_error(
    make: Make, plugins: Plugins, device: Device, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    error = refusal(make(component("hangs")), out, device, hang_after=0.5)
    assert "no answer came within 0.5 s" in error.what
    blamed(error, "hangs")
    assert "stereogs resume" in error.fix
    assert load_run(out, plugins=plugins, device=device).iteration == 4


def test_a_hang_while_it_is_imported_ends_with_an_error(make: Make) -> None:
    with (
        pytest.raises(PluginError, match=r"faulty-hang-at-import 6\.6") as caught,
        WATCHDOG.ending(0.1),
    ):
        make(component("hang_at_import"))
    assert "no answer came within" in caught.value.what
    assert caught.value.where.startswith("p.yaml:5")


def test_growing_memory_is_refused_before_memory_runs_out(
    make: Make,
    plugins: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pipeline, out = make(component("grows_memory")), tmp_path / "run"
    stereogs.train(make(""), progress=False, device=device)  # initial allocations do not count
    monkeypatch.setattr("registry.calls.call.LEDGER", MemoryLedger(limit=resident_bytes() + 8e7))
    error = refusal(pipeline, out, device)
    assert "memory runs out" in error.what
    blamed(error, "grows_memory", iteration=None)
    assert load_run(out, plugins=plugins, device=device).iteration in (4, 6)


def test_a_thread_that_keeps_running_causes_a_warning(
    make: Make, device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    pipeline = make(component("leaves_thread"))
    assert stereogs.train(pipeline, progress=False, device=device).finished
    (warning,) = [message for message in caplog.messages if "left a thread running" in message]
    assert "'leaves_thread' (faulty-leaves-thread 6.6) at p.yaml:5" in warning
    assert "'leftover'" in warning


def test_a_built_in_name_is_refused_and_both_owners_are_named(make: Make) -> None:
    with pytest.raises(PluginError, match="offered twice") as caught:
        make("metrics: [psnr]\n")
    assert "faulty-builtin-name 6.6" in caught.value.what
    assert "toys.psnr" in caught.value.what


def test_a_metric_writes_into_a_copy_of_the_render(make: Make, device: Device) -> None:
    run = stereogs.train(make("metrics: [writes_rendering]\n"), progress=False, device=device)
    assert run.scores["test"].mean == {"writes_rendering": 99.0}
    assert run.rendering(run.scene.test[0].camera).rgb.max() < 1


@pytest.mark.parametrize("name", PRIORS)
def test_errors_of_a_prior_name_the_prior(
    plugins: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, "")
    text = BASE.replace("toy_points", USES_PRIOR.name) + f"priors: [{name}]\n"
    with pytest.raises(PluginError) as caught:
        stereogs.train(
            parse_pipeline(text, plugins, source="p.yaml"), progress=False, device=device
        )
    error = caught.value
    assert PRIORS[name] in error.what
    blamed(error, name, "prior", iteration=None)
    assert f"in initializer {USES_PRIOR.name!r}" in error.where
    assert f"authors of faulty-{name.replace('_', '-')}" in error.fix
    assert "--disable" not in error.fix
