"""`sift_matches`: matches between two images by SIFT features; needs no model file.

SIFT features (Lowe, IJCV 2004) that are mutual nearest neighbours and pass the ratio test, by pycolmap on the
CPU. A substitute for a matching network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Register, Settings, hookimpl
from registry.priors import Matches, MatchingPrior

if TYPE_CHECKING:
    from torch import Tensor


class SiftMatchesSettings(Settings):
    contrast: float = Field(0.002, gt=0)
    """Least contrast of a feature; COLMAP's default, 0.0067, is meant for dozens of photographs."""
    max_features: int = Field(8192, ge=1)
    """Largest number of features per image; those of the largest scale are kept."""
    max_ratio: float = Field(0.8, gt=0, le=1)
    """Largest distance of a match's descriptors relative to the second nearest (Lowe's ratio)."""


class SiftMatches(MatchingPrior[SiftMatchesSettings]):
    """SIFT with mutual nearest neighbours; the score of a match is the cosine of its descriptors."""

    def fingerprint(self) -> str:
        """Version of pycolmap."""
        from importlib.metadata import version

        return f"pycolmap {version('pycolmap')}"

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """Matches in the order of the first image's features."""
        import torch

        from registry.toolkit.photos import import_pycolmap

        colmap = import_pycolmap()
        features = [self._features(colmap, image) for image in (first, second)]
        if not all(len(points) for points, _ in features):
            return Matches(torch.zeros(0, 2), torch.zeros(0, 2), torch.zeros(0))
        options = colmap.FeatureMatchingOptions()
        options.num_threads = 1
        options.sift.max_ratio = self.settings.max_ratio
        matcher = colmap.FeatureMatcher.create(options, colmap.Device.cpu)
        (points, words), (other_points, other_words) = features
        pairs = matcher.match(points, words, other_points, other_words)
        here, there = torch.from_numpy(pairs.astype("int64")).unbind(dim=1)
        likeness = _descriptors(words)[here] * _descriptors(other_words)[there]
        return Matches(
            _pixels(colmap, points)[here],
            _pixels(colmap, other_points)[there],
            likeness.sum(dim=1).clamp(0, 1),
        )

    def _features(self, colmap: Any, image: Tensor) -> tuple[Any, Any]:
        """Keypoints and descriptors of pycolmap."""
        import torch

        from registry.toolkit.images import grey

        options = colmap.FeatureExtractionOptions()
        options.num_threads = 1
        options.sift.peak_threshold = self.settings.contrast
        options.sift.max_num_features = self.settings.max_features
        extractor = colmap.FeatureExtractor.create(options, colmap.Device.cpu)
        brightness = (255 * grey(image).clamp(0, 1)).round().to(torch.uint8)
        return tuple(extractor.extract_from_uint8_array(brightness.numpy()))


def _descriptors(words: Any) -> Tensor:
    """Unit vectors `[F, 128]`."""
    import torch
    from torch.nn.functional import normalize

    return normalize(torch.from_numpy(words.data.astype("float32")), dim=1)


def _pixels(colmap: Any, keypoints: Any) -> Tensor:
    """Columns and rows `[F, 2]`; the centre of the first pixel is (0.5, 0.5), as in COLMAP."""
    import torch

    return torch.from_numpy(colmap.keypoints_to_matrix(keypoints)[:, :2].astype("float32"))


@hookimpl
def stereogs_register_priors(register: Register[SiftMatches]) -> None:
    register("sift_matches", SiftMatches)
