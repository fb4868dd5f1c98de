"""Which runs are comparable, and the reasons for others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from registry import RunError
from stereogs.experiments.comparing.comparability import check_comparable
from stereogs.experiments.comparing.comparison import read_run
from tests.host import AppliedProtocol, RunFolder, load_protocol, main
from tests.stereogs.experiments.comparing.conftest import Capture, Make, runs


def refusal(*folders: Path) -> RunError:
    with pytest.raises(RunError) as caught:
        check_comparable([read_run(folder) for folder in folders])
    for folder in folders[-2:]:
        assert str(folder) in caught.value.where
    assert caught.value.fix
    return caught.value


def test_runs_of_one_protocol_are_compared(make: Make) -> None:
    flower = {"scene/name": "flower", "scene/width": 500, "scene/test": ["image000", "image008"]}
    repeated = {
        "scene/points": 3,
        "scene/extent": 4.25 * (1 + 1e-9),
        "scene/notes": {"dark_background": "black"},
    }
    assert len(runs(make("a"), make("b", flower), make("c", repeated))) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol": None}, "the protocol 'llff-3', the other no protocol"),
        ({"protocol/name": "llff-6"}, "the other the protocol 'llff-6'"),
        (
            {"protocol/modified": {"scene.downsample": 4}},
            "the other the protocol 'llff-3, scene.downsample=4'",
        ),
        ({"protocol/scale": "1/4"}, "`scale` of the protocol"),
        (
            {"protocol/loaders/llff/train_views": 4},
            "`loaders.llff.train_views` of the protocol 'llff-3' changed between the runs",
        ),
        ({"scene/width": 252}, "'fern' differs in `width`: 504 and 252"),
        ({"scene/test": ["image000", "image008"]}, "differs in `test`"),
        ({"scene/extent": 4.3}, "differs in `extent`"),
        ({"scene/facts/source": "images"}, "differs in `facts.source`: images_8 and images"),
        ({"scene/facts/masks": "none"}, "differs in `facts.masks`: None and none"),
        (
            {"metrics/psnr/quantize": "float"},
            "psnr was measured with `quantize` 'png8' and 'float'",
        ),
    ],
)
def test_runs_that_are_not_comparable(make: Make, changes: dict[str, Any], message: str) -> None:
    assert message in refusal(make("a"), make("b", changes)).what


@pytest.mark.parametrize("part", ["photograph", "camera"])
def test_other_test_photographs_and_cameras_are_not_comparable(make: Make, part: str) -> None:
    folders = [make("a"), make("b"), make("c")]
    view = read_run(folders[0]).results["scene"]["test"][0]
    name = f"the {part} of {view}"
    for folder, digest in zip(folders[:2], ("1f", "2e"), strict=True):
        RunFolder(folder).write_inputs({name: digest}, [])
    with pytest.raises(RunError, match=rf"{name.replace(' of ', ' of the test view ')}.* differs"):
        runs(*folders[:2])
    runs(folders[0], folders[2])  # a run of an older version has no digests


def test_title_and_notes_of_a_protocol_may_change(make: Make) -> None:
    runs(make("a"), make("b", {"protocol/notes": "another sentence", "protocol/title": "LLFF"}))


LEGO = {
    "scene/name": "lego",
    "protocol": AppliedProtocol(load_protocol("blender-8"), {}).record(),
}
OLD_VIEWS = {"protocol/loaders/blender/train_ids": [26, 86, 2, 55, 75, 93, 16, 73]}


def test_a_protocol_that_changed_its_views_is_detected(make: Make, capsys: Capture) -> None:
    new, old = make("new", LEGO), make("old", LEGO | OLD_VIEWS)
    assert "`loaders.blender.train_ids` of the protocol" in refusal(new, old).what
    assert main(["compare", str(new), "--paper", "stereogs"]) == 0
    capsys.readouterr()
    assert main(["compare", str(old), "--paper", "stereogs"]) == 2
    said = capsys.readouterr().err
    assert "the protocol 'blender-8' has changed since this run: `loaders.blender.train_ids`" in (
        said
    )


def test_two_scenes_need_a_protocol(make: Make) -> None:
    free = {"protocol": None}
    runs(make("a", free), make("b", free))
    error = refusal(make("c", free), make("d", {**free, "scene/name": "flower"}))
    assert "'fern' and 'flower' and follow no protocol" in error.what


def test_a_difference_between_later_runs_is_found(make: Make) -> None:
    flower = {"scene/name": "flower"}
    other = {**flower, "scene/height": 100}
    assert "'flower' differs" in refusal(make("a"), make("b", flower), make("c", other)).what


def test_settings_of_a_metric_matter_only_if_both_runs_have_its_score(make: Make) -> None:
    measured = {"test/lpips": 0.2, "metrics/lpips/sha256": "ab"}
    other = {"test/lpips": 0.2, "metrics/lpips/sha256": "cd"}
    runs(make("a"), make("b", measured))
    assert "lpips was measured with `sha256`" in refusal(make("c", measured), make("d", other)).what


def test_a_run_without_results_is_explained(make: Make, tmp_path: Path) -> None:
    folder = make("a")
    (folder / "results.json").unlink()
    with pytest.raises(RunError, match="has not finished"):
        read_run(folder)
    with pytest.raises(RunError, match="lacks metrics, gaussians"):
        read_run(make("b", {"metrics": ..., "gaussians": ...}))
    with pytest.raises(RunError, match="lacks the scene's facts"):
        read_run(make("c", {"scene/facts": ...}))
    with pytest.raises(RunError, match="not a run folder"):
        read_run(tmp_path)
