"""`plain_depth`: relative inverse depth from an ONNX file, named by its path and its hash.

    priors:
      - {use: plain_depth, model: /models/depth.onnx, sha256: 0123...}

Nothing is downloaded. `stereogs_plugins` brings `onnx_mono` for well-known networks; this shows how little a
network of one's own needs.
"""

from pydantic import Field
from torch import Tensor

import registry
from registry.priors import MonocularDepthPrior
from registry.toolkit.networks import OnnxModelSettings
from registry.toolkit.networks.image_fitting import full_size_maps, in_range, padded

STEREOGS_API = 3
"""The version of the plugin API that this module was written for."""


class PlainDepthSettings(OnnxModelSettings):
    multiple: int = Field(14, ge=1)
    """The network takes images whose sides are multiples of this many pixels."""


class PlainDepth(MonocularDepthPrior[PlainDepthSettings]):
    """A network that takes `[1, 3, H, W]` with ImageNet's mean and deviation and answers `[1, 1, H, W]`."""

    def __init__(self, settings: PlainDepthSettings, context: registry.Context) -> None:
        super().__init__(settings, context)
        self._model = settings.open()  # checks the hash, and that it is a model at all

    def fingerprint(self) -> str:
        """What answers depend on beside settings and code; they are kept on disk by it."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> Tensor:
        """Return inverse depth without a unit, `[H, W]`, larger = nearer, for `[H, W, 3]` in [0, 1].

        Raises:
            PluginError: the graph answers another shape.
        """
        image_input, output = self._model.input(), self._model.output()
        fit = padded(
            (image.shape[0], image.shape[1]),
            frozen=(image_input.shape[2], image_input.shape[3]),
            multiple=self.settings.multiple,
        )
        batch = in_range(fit.apply(image.permute(2, 0, 1)[None]), "imagenet")
        answers = self._model.run({image_input.name: batch})
        maps = full_size_maps(output.name, answers, (1, *fit.target), self._model.path)
        return fit.undo(maps)[0]


@registry.hookimpl
def stereogs_register_priors(register: registry.Register[PlainDepth]) -> None:
    register("plain_depth", PlainDepth)
