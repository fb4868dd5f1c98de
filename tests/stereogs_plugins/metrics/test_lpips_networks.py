"""LPIPS with the networks that its authors trained it on, where STEREOGS_MODELS has them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from torch import Tensor

from registry import Unavailable
from stereogs_plugins.metrics.lpips import LPIPS, ProperLPIPS
from stereogs_plugins.metrics.lpips.known_files import Files, NetworkName, known_files
from tests.data import models_folder
from tests.stereogs_plugins.building import build

GOLDEN: dict[tuple[type[LPIPS], NetworkName], float] = {
    (LPIPS, "vgg"): 0.198329493,
    (ProperLPIPS, "vgg"): 0.216380212,
    (LPIPS, "alex"): 0.081635757,
    (ProperLPIPS, "alex"): 0.086351345,
}
"""Of `images`, computed once without onnxruntime and without this project: the ONNX files' weights,
torch's convolutions in float64, and the formula of the authors' code with their own .pth files."""


def images() -> tuple[Tensor, Tensor]:
    """Two pictures `[64, 96, 3]` of waves, the second moved by four pixels and paler."""
    v, u = torch.meshgrid(torch.arange(64.0), torch.arange(96.0), indexing="ij")
    waves = (u / 3, v / 5, (u + v) / 9)
    first = torch.stack([0.5 + 0.5 * torch.sin(wave) for wave in waves], dim=2)
    return first, (0.2 + 0.7 * first.roll(4, 1)).clamp(0, 1)


def installed(network: NetworkName) -> Files:
    found = known_files(network)
    if found is None:
        pytest.skip("set STEREOGS_MODELS and call `stereogs models get lpips`")
    return found


@pytest.mark.parametrize(
    ("metric", "network"), GOLDEN, ids=lambda value: getattr(value, "__name__", value)
)
def test_known_networks_measure_what_the_authors_formula_says(
    metric: type[LPIPS], network: NetworkName
) -> None:
    installed(network)
    score = build(metric, network=network).measure(*images(), None)
    assert score == pytest.approx(GOLDEN[metric, network], abs=1e-5)


def test_another_file_of_that_name_is_not_measured_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = installed("alex")
    known = source._replace(
        network=source.network.relative_to(models_folder("")),
        heads=source.heads.relative_to(models_folder("")),
    )
    for file, original in ((known.network, source.network), (known.heads, source.heads)):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        shutil.copy(original, tmp_path / file)
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    assert isinstance(build(LPIPS, network="alex").measure(*images(), None), float)
    with (tmp_path / known.network).open("ab") as file_handle:
        file_handle.write(b"more")
    answer = build(LPIPS, network="alex").measure(*images(), None)
    assert isinstance(answer, Unavailable)
    assert str(known.network) in answer.reason
    assert known.sha256 in answer.reason
    (tmp_path / known.heads).unlink()
    answer = build(LPIPS, network="alex").measure(*images(), None)
    assert isinstance(answer, Unavailable)
    assert "`stereogs models get lpips`" in answer.reason
