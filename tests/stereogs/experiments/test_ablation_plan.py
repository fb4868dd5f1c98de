"""Which combinations an ablation has, in which order, and what "off" is."""

from __future__ import annotations

from pathlib import Path, PureWindowsPath

import pytest

from core_rasterizer import ExplainedError
from stereogs.experiments.planning.plan import Plan
from tests.host import PipelineError, Plugins, parse_pipeline
from tests.registry.toy_plugin import ToyTerm
from tests.stereogs.experiments.ablating import plan, write


def labels(made: Plan) -> list[str]:
    return [made.describe(combination) for combination in made.combinations]


def names(made: Plan, index: int, section: str) -> list[str]:
    return [item.name for item in made.runs[index].pipeline.items[section]]


def test_rows_go_from_all_off_to_all_on(toys: Plugins, tmp_path: Path) -> None:
    made = plan(write(tmp_path), toys, toggles="toy_dropout,second,densification")
    assert [combination.on for combination in made.combinations] == [
        (False, False, False),
        (True, False, False),
        (False, True, False),
        (False, False, True),
        (True, True, False),
        (True, False, True),
        (False, True, True),
        (True, True, True),
    ]
    assert labels(made)[1] == "toy_dropout on, second off, densification off"
    assert names(made, 0, "modifiers") == names(made, 0, "densification") == []
    assert names(made, 0, "regularizers") == ["toy_term"]
    assert names(made, 7, "regularizers") == ["toy_term", "second"]
    assert names(made, 7, "densification") == ["toy_growth"]


def test_all_on_is_the_unchanged_pipeline(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path)
    made = plan(path, toys, toggles="modifiers.toy_dropout,toy_term")
    assert made.runs[-1].pipeline == parse_pipeline(path.read_text(), toys)


@pytest.mark.parametrize(
    ("written", "labels"),
    [
        ("./a,{use: toy_scene, test_views: 0, name: x}", ("a", "x")),
        ('{use: toy_scene, path: "x/b, it\'s"},./c', ("b, it's", "c")),
        ("'./d, e', ./it's, 2024", ("d, e", "it's", "2024")),
        ("./f[1],./{g", ("f[1]", "{g")),
    ],
)
def test_scenes_are_split_like_values(
    toys: Plugins,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    written: str,
    labels: tuple[str, ...],
) -> None:
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    made = plan(write(tmp_path), toys, toggles="second", scenes=written)
    assert made.scenes == labels


def test_a_scene_that_ends_too_early_is_refused(toys: Plugins, tmp_path: Path) -> None:
    with pytest.raises(PipelineError, match="--scenes"):
        plan(write(tmp_path), toys, toggles="second", scenes="{use: toy_scene, ./a")


def test_a_scene_with_backslashes_is_a_path_on_windows(
    toys: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sep", "\\")
    monkeypatch.setattr("stereogs.experiments.planning.variations.PurePath", PureWindowsPath)
    made = plan(write(tmp_path), toys, toggles="second", scenes=r"C:\data\fern,..\room")
    assert made.scenes == ("fern", "room")
    assert made.runs[0].pipeline.one("scene").settings.model_dump()["path"] == Path(r"C:\data\fern")


def test_seeds_vary_fastest_then_scenes(toys: Plugins, tmp_path: Path) -> None:
    made = plan(write(tmp_path), toys, vary=("opacity.factor=0.5,0.6",), scenes="./a,./b", seeds=2)
    assert made.size == "2 combinations x 2 scenes x 2 seeds = 8 runs"
    assert [(made.describe(r.combination), r.scene, r.seed) for r in made.runs[:5]] == [
        ("opacity.factor 0.5", "a", 7),
        ("opacity.factor 0.5", "a", 8),
        ("opacity.factor 0.5", "b", 7),
        ("opacity.factor 0.5", "b", 8),
        ("opacity.factor 0.6", "a", 7),
    ]
    assert made.runs[3].pipeline.training.seed == 8
    assert made.runs[3].pipeline.one("scene").settings.model_dump()["path"] == Path("b")
    assert len({run.name for run in made.runs}) == 8


def test_a_value_of_a_disabled_component_makes_no_row(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path, "toggles: {opacity: {off: {use: toy_fade, reset: true}}}\n")
    made = plan(path, toys, vary=("opacity.factor=0.5,0.6", "training.sh_degree=0,1"))
    assert labels(made) == [
        "opacity off, training.sh_degree 0",
        "opacity off, training.sh_degree 1",
        "opacity on, opacity.factor 0.5, training.sh_degree 0",
        "opacity on, opacity.factor 0.5, training.sh_degree 1",
        "opacity on, opacity.factor 0.6, training.sh_degree 0",
        "opacity on, opacity.factor 0.6, training.sh_degree 1",
    ]
    (policy,) = made.runs[0].pipeline.items["opacity"]
    assert policy.settings.model_dump() == {"factor": 0.9, "value": None, "reset": True}


def test_the_baseline_of_the_file_replaces_the_component(toys: Plugins, tmp_path: Path) -> None:
    made = plan(
        write(
            tmp_path,
            "toggles:\n"
            "  initializer: {off: {use: toy_points, count: 3}}\n"
            "  second: {off: {use: toy_term, name: other}}\n",
        ),
        toys,
    )
    assert made.runs[0].pipeline.to_yaml().count("  count: 3\n") == 1
    assert made.runs[-1].pipeline.to_yaml().count("  count: null\n") == 1
    assert names(made, 0, "regularizers") == ["toy_term", "other"]


def test_default_baselines_are_those_of_3dgs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.host import SELECTION

    chosen = "procedural,random,sfm,opacity_reset,constant_decay"
    monkeypatch.setenv(SELECTION, chosen)
    path = tmp_path / "p.yaml"
    path.write_text(
        "name: p\nscene: procedural\ninitializer: random\nopacity: constant_decay\n"
        "training: {iterations: 30000}\n"
    )
    off = plan(path, Plugins(), toggles="initializer,constant_decay").runs[0].pipeline
    assert off.one("initializer").name == "sfm"
    (policy,) = off.items["opacity"]
    schedule = policy.schedule
    assert (policy.name, schedule.every, schedule.stop) == ("opacity_reset", 3000, 14970)


def test_a_component_without_baseline_is_disabled_unless_required(
    toys: Plugins, tmp_path: Path
) -> None:
    off = plan(write(tmp_path), toys, toggles="opacity").runs[0].pipeline
    assert off.items["opacity"] == ()
    with pytest.raises(
        PipelineError, match="the initializer is required and has no baseline"
    ) as caught:
        plan(write(tmp_path), toys, toggles="initializer")
    assert "{initializer: {off: NAME}}" in caught.value.fix


def test_any_component_can_name_a_baseline(
    toys: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ToyTerm, "ablation_baseline", "toy_term")
    renamed = ("regularizers.toy_term.name=first",)
    off = plan(write(tmp_path), toys, toggles="second", overrides=renamed).runs[0].pipeline
    assert [item.name for item in off.items["regularizers"]] == ["first", "toy_term"]
    off = plan(write(tmp_path), toys, toggles="second").runs[0].pipeline
    assert [item.name for item in off.items["regularizers"]] == ["toy_term"], "there already"


def test_named_alternatives_change_several_settings(toys: Plugins, tmp_path: Path) -> None:
    made = plan(
        write(
            tmp_path,
            "vary:\n"
            "  term:\n"
            "    none: {regularizers.second.enabled: false}\n"
            "    as it is: {}\n"
            "    2.5: {regularizers.second.weight: 2.5, regularizers.second.target: 0.1}\n",
        ),
        toys,
    )
    assert labels(made) == ["term none", "term as it is", "term 2.5"]
    assert names(made, 0, "regularizers") == ["toy_term"]
    second = made.runs[2].pipeline.items["regularizers"][1]
    assert (second.host.weight, second.settings.model_dump()["target"]) == (2.5, 0.1)
    assert [choice.number for choice in made.variations[0].choices] == [None, None, 2.5]


def test_components_as_values_are_labelled_by_name(toys: Plugins, tmp_path: Path) -> None:
    vary = ("opacity={use: toy_fade, name: slow, factor: 0.99},toy_fade", "metrics=[],[psnr]")
    made = plan(write(tmp_path), toys, vary=vary)
    assert labels(made) == [
        "opacity slow, metrics []",
        'opacity slow, metrics ["psnr"]',
        "opacity toy_fade, metrics []",
        'opacity toy_fade, metrics ["psnr"]',
    ]


def test_a_scene_without_a_slash_is_in_the_data_folder(
    toys: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path / "data"))
    path = write(
        tmp_path,
        "vary: {opacity.factor: [0.5]}\n"
        "scenes: [fern, {use: toy_scene, test_views: 0}, {use: toy_scene, name: x, strict: true}]\n",
    )
    made = plan(path, toys)
    assert made.scenes == ("fern", "toy_scene", "x")
    assert made.runs[0].pipeline.one("scene").settings.model_dump()["path"] == (
        tmp_path / "data" / "fern"
    )
    assert made.runs[1].pipeline.one("scene").settings.model_dump()["path"] == Path("nowhere")
    assert plan(write(tmp_path), toys, toggles="second").scenes == ("garden",)


def test_command_line_arguments_replace_entries_of_the_file(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path, "toggles: {second: }\nvary: {opacity.factor: [0.5, 0.6]}\nseeds: 3\n")
    assert plan(path, toys).size == "4 combinations x 1 scene x 3 seeds = 12 runs"
    made = plan(
        path,
        toys,
        toggles="toy_term",
        vary=("opacity.factor=0.1",),
        seeds=1,
        overrides=("opacity.reset=true",),
    )
    assert labels(made) == ["toy_term off, opacity.factor 0.1", "toy_term on, opacity.factor 0.1"]
    (policy,) = made.runs[0].pipeline.items["opacity"]
    assert policy.settings.model_dump()["reset"] is True


def test_another_pipeline_uses_other_folders(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path)
    before = {run.digest for run in plan(path, toys, toggles="second").runs}
    again = {run.digest for run in plan(path, toys, toggles="second").runs}
    longer = ("training.iterations=6",)
    after = {run.digest for run in plan(path, toys, toggles="second", overrides=longer).runs}
    assert before == again
    assert not before & after


@pytest.mark.parametrize(
    ("toggles", "message", "fix"),
    [
        ("toy_drpout", "did you mean 'toy_dropout'", "toy_dropout"),
        ("reports", "no component 'reports'", "opacity"),
        ("second,second", "toggled twice", "once"),
        ("second,regularizers.second", "toggled twice", "once"),
        ("second,,opacity", "empty name", "commas"),
        ("scene", "cannot be toggled", "--scenes"),
    ],
)
def test_wrong_toggles(toys: Plugins, tmp_path: Path, toggles: str, message: str, fix: str) -> None:
    with pytest.raises(ExplainedError, match=message) as caught:
        plan(write(tmp_path), toys, toggles=toggles)
    assert "--toggle" in caught.value.where
    assert fix in caught.value.fix


def test_an_ambiguous_name_needs_its_section(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace("[toy_dropout]", "[{use: toy_dropout, name: second}]"))
    with pytest.raises(PipelineError, match="is ambiguous") as caught:
        plan(path, toys, toggles="second")
    assert "regularizers.second, modifiers.second" in caught.value.fix
    assert plan(path, toys, toggles="modifiers.second").toggles == ("modifiers.second",)


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        (("opacity.factr=0.5,0.6",), "did you mean 'factor'"),
        (("opacty.factor=0.5",), "did you mean 'opacity'"),
        (("regularizers.third.weight=1",), "no item 'third'"),
        (("opacity.factor=",), "no values"),
        (("opacity.factor=0.5,0.50",), "0.5 twice"),
        (("opacity.factor=much",), "must be a number"),
        (("opacity.factor",), "must look like"),
        (("=3",), "must look like"),
        (("opacity.factor=0.5", "opacity.factor=0.6"), "varied twice"),
        (("training.seed=1,2",), "seed cannot be varied"),
        (("opacity.factor={",), "not valid YAML"),
    ],
)
def test_wrong_variations(
    toys: Plugins, tmp_path: Path, vary: tuple[str, ...], message: str
) -> None:
    with pytest.raises(PipelineError, match=message) as caught:
        plan(write(tmp_path), toys, vary=vary)
    assert "--vary" in caught.value.where


def test_equal_combinations_are_rejected(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path, "toggles: {initializer: {off: toy_points}}\n")
    with pytest.raises(PipelineError, match="are the same pipeline"):
        plan(path, toys)
    with pytest.raises(PipelineError, match="the same pipeline"):
        plan(write(tmp_path), toys, vary=("opacity.factor=1,1.0",))
    with pytest.raises(PipelineError, match="two scenes are called 'a'"):
        plan(write(tmp_path), toys, toggles="second", scenes="./a,b/a")


def test_nothing_to_do_and_too_few_seeds(toys: Plugins, tmp_path: Path) -> None:
    with pytest.raises(PipelineError, match="nothing to toggle"):
        plan(write(tmp_path), toys, seeds=3)
    with pytest.raises(PipelineError, match="1 or more, not 0"):
        plan(write(tmp_path), toys, toggles="second", seeds=0)
