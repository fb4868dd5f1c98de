"""LPIPS with the networks that its authors trained it on, where STEREOGS_MODELS has them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from torch import Tensor

from registry import Unavailable
from stereogs_plugins.metrics.lpips import LPIPS, ProperLPIPS
from stereogs_plugins.metrics.lpips.known_files import KNOWN, NetworkName
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


@pytest.mark.parametrize(
    ("metric", "network"), GOLDEN, ids=lambda value: getattr(value, "__name__", value)
)
def test_known_networks_measure_what_the_authors_formula_says(
    metric: type[LPIPS], network: NetworkName
) -> None:
    for file in (KNOWN[network].network, KNOWN[network].heads):
        models_folder(file.parts[0])
    score = build(metric, network=network).measure(*images(), None)
    assert score == pytest.approx(GOLDEN[metric, network], abs=1e-5)


def test_another_file_of_that_name_is_not_measured_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = KNOWN["alex"]
    source = models_folder(known.network.parts[0]).parent
    for file in (known.network, known.heads):
        (tmp_path / file).parent.mkdir()
        shutil.copy(source / file, tmp_path / file)
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
    assert str(known.heads) in answer.reason
