"""`plain_depth`: relative inverse depth from an ONNX file, identified by path and hash.

    priors:
      - {use: plain_depth, model: /models/depth.onnx, sha256: 0123...}

`stereogs_plugins` has `onnx_mono` for well-known networks; this example shows the minimum for a network of
your own.
"""

from pydantic import Field
from torch import Tensor

from registry.toolkit.networks import OnnxModelSettings
from registry.toolkit.networks.image_fitting import full_size_maps, in_range, padded
from stereogs import api
from stereogs.api import MonocularDepthPrior

STEREOGS_API = 1
"""Version of the plugin API that this module was written for."""


class PlainDepthSettings(OnnxModelSettings):
    multiple: int = Field(14, ge=1)
    """Multiple, in pixels, that both sides of the network's input must have."""


class PlainDepth(MonocularDepthPrior[PlainDepthSettings]):
    """Network with input `[1, 3, H, W]`, normalized as for ImageNet, and output `[1, 1, H, W]`."""

    def __init__(self, settings: PlainDepthSettings, context: api.Context) -> None:
        super().__init__(settings, context)
        self._model = settings.open()  # checks hash and format

    def fingerprint(self) -> str:
        """Return the hash of the file, so that cached answers of another file are not used."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> Tensor:
        """Return inverse depth without a unit, `[H, W]`, larger = nearer, for `[H, W, 3]` in [0, 1].

        Raises:
            PluginError: the graph's output has another shape.
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


@api.hookimpl
def stereogs_register_priors(register: api.Register[PlainDepth]) -> None:
    register("plain_depth", PlainDepth)
