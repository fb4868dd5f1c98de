"""`lpips` and `lpips_proper`: learned perceptual distance (Zhang et al. 2018, version 0.1).

    d = sum over five layers of the mean over pixels of sum_c w_c (f_c / |f| - g_c / |g|)²

with f and g the network's features of the two images. The network was trained on colours in [-1, 1].
Papers on sparse views use colours in [0, 1]: `lpips`. `lpips_proper` uses 2 x - 1. The two scores are not
comparable.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self, TypeAlias

import pydantic

from registry import AverageErrorRole, Metric, PluginError, Register, Unavailable, hookimpl
from registry.toolkit.images import ImageMetricSettings
from registry.toolkit.networks import MODELS_VARIABLE, Sha256

from .known_files import KNOWN, NetworkName, known_files

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from .files import Network

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
"""ImageNet's mean and deviation for colours in [-1, 1], red, green and blue."""
EPSILON = 1e-10
"""Added to the norm of a pixel's features, to avoid a division by 0."""

Distance: TypeAlias = "Callable[[Tensor, Tensor], float]"


class LPIPSSettings(ImageMetricSettings):
    network: NetworkName = "vgg"
    """Network of the files; the published tables use VGG. Give a second network a `name`."""
    file: Path | None = None
    """A local .onnx or TorchScript file: either the feature network, from one image to five features, or
    all of LPIPS, from two images to one number. null: the default files in the folder STEREOGS_MODELS
    (docs/protocols.md); without them the score is not available."""
    sha256: Sha256 | None = None
    """The file's SHA-256, 64 hexadecimal digits."""
    heads: Path | None = None
    """The weights of the five layers, .safetensors, .npz or .pth; null if `file` is all of LPIPS."""
    heads_sha256: Sha256 | None = None
    """The SHA-256 of `heads`."""

    @pydantic.model_validator(mode="after")
    def _named_by_hash(self) -> Self:
        for path, digest in (("file", "sha256"), ("heads", "heads_sha256")):
            if (getattr(self, path) is None) != (getattr(self, digest) is None):
                raise ValueError(f"`{path}` and `{digest}` require each other; see `sha256sum`")
        if self.heads is not None and self.file is None:
            raise ValueError("`heads` without `file`: the network is missing")
        return self


class LPIPS(Metric[LPIPSSettings]):
    """On colours in [0, 1], as in papers on sparse views; with a mask, white outside it."""

    higher_is_better = False
    average_error_role: ClassVar[AverageErrorRole | None] = "perceptual_distance"
    takes_long: ClassVar[bool] = True
    proper: ClassVar[bool] = False

    def measure(
        self, rendered: Tensor, photograph: Tensor, mask: Tensor | None
    ) -> float | Unavailable:
        """Return the distance, 0 for equal images.

        Raises:
            PluginError: the files have another hash or do not match the settings.
        """
        from registry.toolkit.images import white_outside

        if isinstance(self._distance, Unavailable):
            return self._distance
        first, second = (
            self._planes(white_outside(self.settings.prepared(image), mask))
            for image in (rendered, photograph)
        )
        return self._distance(first, second)

    def _planes(self, image: Tensor) -> Tensor:
        planes = image.permute(2, 0, 1)[None].float()
        return 2 * planes - 1 if self.proper else planes

    @cached_property
    def _distance(self) -> Distance | Unavailable:
        from .files import read_heads, read_network

        settings = self.settings
        if settings.file is None or settings.sha256 is None:
            return self._known_distance()
        for path in (settings.file, settings.heads):
            if path is not None and not path.expanduser().is_file():
                return Unavailable(f"the file {path} does not exist; see `stereogs models`")
        network = read_network(settings.file.expanduser(), settings.sha256)
        if settings.heads is None or settings.heads_sha256 is None:
            return _WholeDistance(network, settings.file)
        heads = read_heads(settings.heads.expanduser(), settings.heads_sha256, settings.network)
        return _FeatureDistance(network, heads, settings.file)

    def _known_distance(self) -> Distance | Unavailable:
        from .files import read_heads, read_network

        name = self.settings.network
        found = known_files(name)
        if found is None:
            wanted = KNOWN[name][0]
            return Unavailable(
                f"{MODELS_VARIABLE} is not a folder with {wanted.network} and {wanted.heads}: "
                "`stereogs models get lpips` writes them; or set `file`, `sha256` and `heads`"
            )
        try:
            heads = read_heads(found.heads, found.heads_sha256, name)
            network = read_network(found.network, found.sha256)
        except PluginError as error:  # default files must not fail a run
            return Unavailable(f"{error.where}: {error.what}")
        return _FeatureDistance(network, heads, found.network)


class ProperLPIPS(LPIPS):
    """On colours in [-1, 1], as the authors of LPIPS define it; with a mask, white outside it."""

    average_error_role = None
    proper = True


class _WholeDistance:
    """LPIPS by a network that computes the distance."""

    def __init__(self, network: Network, file: Path) -> None:
        self._network, self._file = network, file

    def __call__(self, first: Tensor, second: Tensor) -> float:
        outputs = self._network(first, second)
        if len(outputs) != 1 or outputs[0].numel() != 1:
            raise PluginError(
                "the network does not return one number for two images",
                where=str(self._file),
                fix="set `heads` if it is a feature network",
            )
        return float(outputs[0])


class _FeatureDistance:
    """LPIPS from features and the weights of their channels."""

    def __init__(self, network: Network, heads: list[Tensor], file: Path) -> None:
        self._network, self._heads, self._file = network, heads, file

    def __call__(self, first: Tensor, second: Tensor) -> float:
        distance = 0.0
        pairs = zip(self._features(first), self._features(second), self._heads, strict=True)
        for one, other, weights in pairs:
            squares = (_directions(one) - _directions(other)) ** 2
            distance += float((weights[:, None, None] * squares).sum(0).mean())
        return distance

    def _features(self, planes: Tensor) -> list[Tensor]:
        import torch

        shift, scale = (torch.tensor(values).view(1, 3, 1, 1) for values in (SHIFT, SCALE))
        outputs = self._network((planes - shift) / scale)
        found = [list(output.shape[:2]) for output in outputs]
        wanted = [[1, len(weights)] for weights in self._heads]
        if found != wanted or any(output.ndim != 4 for output in outputs):
            shapes = ", ".join(str(list(output.shape)) for output in outputs)
            raise PluginError(
                f"the network's features have the shapes {shapes}",
                where=str(self._file),
                fix=f"it must return five, [1, C, h, w] with C = {', '.join(str(c) for _, c in wanted)}",
            )
        return [output[0].double() for output in outputs]


def _directions(features: Tensor) -> Tensor:
    """Normalize each pixel's features `[C, h, w]`."""
    return features / (features.square().sum(0).sqrt() + EPSILON)


@hookimpl
def stereogs_register_metrics(register: Register[LPIPS]) -> None:
    register("lpips", LPIPS)
    register("lpips_proper", ProperLPIPS)
