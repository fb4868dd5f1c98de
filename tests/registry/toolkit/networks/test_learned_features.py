"""Features of a tiny graph like MC-CNN fast: the vector (g, 2 g + 1) for a grey level g."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from registry import PluginError
from registry.toolkit.networks.feature_networks import LearnedFeatures, standardized_grey
from tests.stereogs_plugins.priors import graphs


def test_grey_is_standardized_over_the_image() -> None:
    image = torch.rand(20, 30, 3, generator=torch.Generator().manual_seed(0))
    grey = standardized_grey(image)
    assert grey.shape == (20, 30)
    assert abs(float(grey.mean())) < 1e-5
    assert float(grey.std(correction=0)) == pytest.approx(1, abs=1e-5)
    luma = 0.299 * image[..., 0] + 0.587 * image[..., 1] + 0.114 * image[..., 2]
    assert torch.allclose(grey, (luma - luma.mean()) / luma.std(correction=0), atol=1e-5)


def test_exposure_and_contrast_change_nothing() -> None:
    image = torch.rand(20, 30, 3) * 0.5
    assert torch.allclose(standardized_grey(image), standardized_grey(0.3 + 1.2 * image), atol=1e-4)


def test_a_flat_image_has_no_texture() -> None:
    assert standardized_grey(torch.full((20, 30, 3), 0.3)).abs().max() < 0.1


def test_features_are_normalized_outputs_of_the_graph(tmp_path: Path) -> None:
    features = LearnedFeatures(graphs.grey_features(tmp_path / "m.onnx"))
    image = torch.rand(21, 33, 3, generator=torch.Generator().manual_seed(0))
    answer = features(image)
    assert answer.shape == (2, 21, 33)
    assert torch.allclose(answer.norm(dim=0), torch.ones(21, 33), atol=1e-5)
    grey = standardized_grey(image)
    direction = torch.stack([grey, 2 * grey + 1])
    assert torch.allclose(answer, direction / direction.norm(dim=0), atol=1e-5)
    assert torch.equal(answer, features(image))


def test_fingerprints_of_files_differ(tmp_path: Path) -> None:
    one = LearnedFeatures(graphs.grey_features(tmp_path / "one.onnx"))
    other = LearnedFeatures(graphs.grey_features(tmp_path / "other.onnx", offset=2.0))
    assert one.fingerprint != other.fingerprint


def test_other_graphs_are_refused(tmp_path: Path) -> None:
    image = torch.rand(20, 30, 3)
    with pytest.raises(PluginError, match="does not match the input"):
        LearnedFeatures(graphs.color_features(tmp_path / "color.onnx"))(image)
    with pytest.raises(PluginError, match="its name must be specified"):
        LearnedFeatures(graphs.matcher(tmp_path / "stereo.onnx"))
    with pytest.raises(PluginError, match=r"expected \[1, C, 20, 30\]"):
        LearnedFeatures(graphs.grey_features(tmp_path / "small.onnx", shrink=2))(image)
    with pytest.raises(PluginError, match="not finite"):
        LearnedFeatures(graphs.grey_features(tmp_path / "nan.onnx", offset=float("nan")))(image)
    with pytest.raises(PluginError, match="SHA-256"):
        LearnedFeatures(graphs.grey_features(tmp_path / "m.onnx"), "0" * 64)
