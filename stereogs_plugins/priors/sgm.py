"""`sgm`: disparity of rectified pairs by semi-global matching; needs no model file.

Matching costs (census, correlation, or features of a network) are aggregated along eight paths
(Hirschmüller, PAMI 2008); the cheapest disparity is refined to subpixel precision.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from core_rasterizer.matching import MAX_PENALTY, MAX_RADIUS
from registry import Context, PluginError, Register, Settings, hookimpl
from registry.priors import StereoPrior
from registry.toolkit.networks import OnnxModel, OnnxProvider, Sha256

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from core_rasterizer.matching import CostVolume


class SgmSettings(Settings):
    max_disparity: int = Field(192, ge=1, le=1024)
    """Largest disparity searched, pixels; time and memory grow with it."""
    cost: Literal["census", "zncc", "features"] = "census"
    """Matching cost: census of 9x7 windows, correlation of square windows, or features of a network."""
    radius: int = Field(2, ge=1, le=MAX_RADIUS)
    """Radius of the windows of `zncc`, pixels."""
    features: Path | None = None
    """For the cost `features`: path of an ONNX file that maps a grey image `[N, 1, H, W]` with mean 0 and
    standard deviation 1 to feature vectors `[N, C, H, W]`, as MC-CNN fast does."""
    sha256: Sha256 | None = None
    """Required hash of the file; null accepts any file."""
    provider: OnnxProvider | None = None
    """Execution provider of the network; null: the first of this list that is installed."""
    small_penalty: int = Field(80, ge=0, le=MAX_PENALTY)
    """Penalty P1 for a disparity change of one between two pixels; a match costs 0 to 255."""
    large_penalty: int = Field(6000, ge=0, le=MAX_PENALTY)
    """Penalty P2 for a larger change; divided by the difference of the two grey levels, at least P1."""
    median: bool = True
    """Replace each disparity by the median of its 3x3 neighbourhood."""


class SgmPrior(StereoPrior[SgmSettings]):
    """Semi-global matching.

    Every pixel gets a disparity. Occluded pixels get one that fits their surroundings and may point outside
    the other image; a left-right check finds them. A disparity of 0, as in flat images, counts as unknown.

    Raises:
        PluginError: `small_penalty` exceeds `large_penalty`, `cost: features` has no file, or another cost
            has one; see `LearnedFeatures` for the file.
    """

    def __init__(self, settings: SgmSettings, context: Context) -> None:
        from core_rasterizer.matching import Penalties
        from registry.toolkit.networks import LearnedFeatures

        super().__init__(settings, context)
        if settings.small_penalty > settings.large_penalty:
            raise PluginError(
                f"small_penalty {settings.small_penalty} is more than "
                f"large_penalty {settings.large_penalty}",
                fix="set `large_penalty` to at least `small_penalty`",
            )
        if (settings.cost == "features") != (settings.features is not None):
            raise PluginError(
                f"the cost is {settings.cost!r} but `features` is {settings.features}",
                fix="set `features` to an ONNX file together with `cost: features`, or neither",
            )
        self._penalties = Penalties(settings.small_penalty, settings.large_penalty)
        self._features = settings.features and LearnedFeatures(
            settings.features, settings.sha256, settings.provider
        )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The cost `features`, for a file with learned features."""
        from registry.toolkit.networks import LearnedFeatures

        if not LearnedFeatures.recognizes(model):
            return []
        return [{"cost": "features", "features": str(model.path), "sha256": model.sha256}]

    @property
    def max_disparity(self) -> float:
        """The setting of that name."""
        return float(self.settings.max_disparity)

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the left image's disparity `[H, W]`, pixels; 0 where unknown.

        Raises:
            MemoryBudgetError: the cost volumes need more than half of the device's memory.
        """
        return self._cheapest(self._costs(left, right), left)

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Disparities of both images from one computation of the matching costs."""
        from core_rasterizer.matching import right_costs

        costs = self._costs(left, right)
        mirrored = right_costs(self.context.device, costs)
        return self._cheapest(costs, left), self._cheapest(mirrored, right)

    def _planes(self, image: Tensor) -> int:
        """Number of disparities 0, 1, ...; at most the image's width."""
        return min(self.settings.max_disparity + 1, image.shape[1])

    def _costs(self, left: Tensor, right: Tensor) -> CostVolume:
        from core_rasterizer.matching import census_costs, feature_costs, zncc_costs
        from registry.toolkit.images import grey

        device, planes = self.context.device, self._planes(left)
        if self._features:
            return feature_costs(device, self._features(left), self._features(right), planes)
        greys = grey(left), grey(right)
        if self.settings.cost == "zncc":
            return zncc_costs(device, *greys, planes, self.settings.radius)
        return census_costs(device, *greys, planes)

    def _cheapest(self, costs: CostVolume, image: Tensor) -> Tensor:
        from core_rasterizer.matching import aggregate, pick
        from registry.toolkit.images import grey

        device = self.context.device
        sums = aggregate(device, costs, grey(image), self._penalties)
        disparity, _ = pick(device, sums, self._planes(image))
        if self.settings.median:
            disparity = _median_of_neighbours(disparity)
        return disparity


def _median_of_neighbours(values: Tensor) -> Tensor:
    """Median of 3x3 pixels, with a repeated border."""
    from torch.nn.functional import pad

    padded = pad(values[None], (1, 1, 1, 1), mode="replicate")[0]
    return padded.unfold(0, 3, 1).unfold(1, 3, 1).flatten(2).median(-1).values


@hookimpl
def stereogs_register_priors(register: Register[SgmPrior]) -> None:
    register("sgm", SgmPrior)
