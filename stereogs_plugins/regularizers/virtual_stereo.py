"""`virtual_stereo`: a render from a shifted camera, warped back by the rendered disparity, must match the
photograph (Binocular3DGS, Han et al. 2024).

For a shift t along the camera's x axis, a pixel with rendered depth z has the disparity -f t / z.
Gradients reach the Gaussians through both renders: the colours and the depth.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import HostDefaults, Percent, Register, Regularizer, Settings, Step, hookimpl
from registry.toolkit.images import at_size

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import PixelTerm

Kind = Literal["accumulated", "expected"]
HELPERS = """
#define MIN_ALPHA (3 / (real)10) /* for depth / alpha: dropout and decay leave less than 1 on surfaces */
#define EDGE (33 / (real)100)    /* decay of the smoothness at edges of the photograph (the authors' code) */

#if HAS_trained
#define TRAINED(q) trained[q]
#else
#define TRAINED(q) 1
#endif
#if HAS_solid
#define SOLID(q) solid[q]
#else
#define SOLID(q) 1
#endif
/* Whether a pixel has a depth that may be used, and a disparity less than the width of the image. */
#if EXPECTED
#define DEPTH(q) (view_depth[q] / view_alpha[q])
#define FAR(q) (view_alpha[q] > MIN_ALPHA && SOLID(q) && view_depth[q] * width > least * view_alpha[q])
#else
#define DEPTH(q) view_depth[q]
#define FAR(q) (view_depth[q] * width > least)
#endif
#define SEEN(q) (FAR(q) && TRAINED(q))

typedef GLUE(REAL_NAME, 4) four;
#define ABS(v) ((v) < 0 ? -(v) : (v))
#define SIGN(v) ((real)((v) > 0) - (real)((v) < 0))
#define OF_FOUR(f) (four)(f(q0), f(q1), f(q2), f(q3))
#define CONTRAST(f) ABS(OF_FOUR(f) - f(p))
#define RED(q) target[3 * (q)]
#define GREEN(q) target[3 * (q) + 1]
#define BLUE(q) target[3 * (q) + 2]
"""
SOURCE = """
const real least = ABS(moves);
if (!SEEN(p))
    continue;
const real depth = DEPTH(p), disparity = moves / depth, column = x + disparity;
real by_disparity = 0;
if (column >= 0 && column <= width - 1) {
    const int left = column < width - 1 ? (int)column : width > 1 ? width - 2 : 0;
    const int first = 3 * (y * width + left), second = width > 1 ? first + 3 : first;
    const real part = column - left, share = 1 / ((real)3 * width * height);
    for (int c = 0; c < 3; c++) {
        const real step = shifted_rgb[second + c] - shifted_rgb[first + c];
        const real error = shifted_rgb[first + c] + part * step - target[3 * p + c];
        const real slope = share * SIGN(error);
        loss += share * ABS(error);
        d_shifted_rgb[first + c] += (1 - part) * slope;
        d_shifted_rgb[second + c] += part * slope;
        by_disparity += step * slope;
    }
}
if (smoothness > 0) {
    /* Differences to the pixels two away; a pixel that does not count is replaced by this one. */
    const int q0 = x + 2 < width && SEEN(p + 2) ? p + 2 : p, q1 = x >= 2 && SEEN(p - 2) ? p - 2 : p;
    const int q2 = y + 2 < height && SEEN(p + 2 * width) ? p + 2 * width : p;
    const int q3 = y >= 2 && SEEN(p - 2 * width) ? p - 2 * width : p;
    const real across = smoothness / ((real)(width > 2 ? width - 2 : 1) * height);
    const real down = smoothness / ((real)(height > 2 ? height - 2 : 1) * width);
    const four shares = (four)(across * (q0 > p), across * (q1 < p), down * (q2 > p), down * (q3 < p));
    const four slopes = (moves / OF_FOUR(DEPTH) - disparity) / 2;
    const four edges = CONTRAST(RED) + CONTRAST(GREEN) + CONTRAST(BLUE);
    const four weights = shares * exp(edges * (-EDGE / 6));
    const four changes = slopes > 0 ? weights : slopes < 0 ? -weights : 0;
    loss += weights.s0 * ABS(slopes.s0) + weights.s2 * ABS(slopes.s2);
    by_disparity -= (changes.s0 + changes.s1 + changes.s2 + changes.s3) / 2;
}
#if EXPECTED
d_view_depth[p] = -by_disparity * disparity / view_depth[p];
d_view_alpha[p] = by_disparity * disparity / view_alpha[p];
#else
d_view_depth[p] = -by_disparity * disparity / depth;
#endif
"""


class VirtualStereoSettings(Settings):
    max_shift: float = Field(0.4, gt=0, allow_inf_nan=False)
    """The shift is uniform in [-max_shift, max_shift]. The default is the authors', for COLMAP's world
    units, where near content then moves by at most 10 pixels."""
    unit: Literal["world", "baseline"] = "world"
    """Unit of `max_shift`: that of the scene's files, or the distance to the nearest other camera."""
    depth: Kind = "accumulated"
    """Rendered depth: as blended (the paper), which is too small where dropout or decay reduce alpha; or
    divided by alpha, at pixels with an alpha above 0.3 that show no background in a photograph with alpha."""
    smoothness: float = Field(0.05, ge=0, allow_inf_nan=False)
    """Weight of the edge-aware smoothness of the disparity, relative to the colour difference."""


class VirtualStereo(Regularizer[VirtualStereoSettings]):
    """mean |warped - photograph| over all pixels, 0 where the warp is undefined, plus smoothness.

    Pixels whose disparity would exceed the image width, or that do not train, are ignored.
    """

    host_defaults = HostDefaults(start=Percent(66.67))

    def loss(self, step: Step) -> Tensor:
        """Return the loss for this iteration's view."""
        import torch

        sample, kind = step.sample, self.settings.depth
        drawn = float(torch.rand((), generator=self.generator))
        shift = self.settings.max_shift * self._unit(step) * (2 * drawn - 1)
        solid = step.view.solid if kind == "expected" else None
        return term(kind)(
            view=step.rendering,
            shifted=step.render(sample.camera.shifted_right(shift)),
            target=sample.target,
            trained=sample.trained,
            solid=None if solid is None else at_size(solid, *sample.target.shape[:2]),
            moves=-sample.camera.fx * shift,
            smoothness=self.settings.smoothness,
        )

    def _unit(self, step: Step) -> float:
        """World units of a shift of 1; with a single training camera a baseline is the scene's extent."""
        if self.settings.unit == "world":
            return 1 / step.scene.frame.unit
        here = step.view.camera.center
        others = [view.camera.center for view in step.scene.train if view.name != step.view.name]
        return min((float((there - here).norm()) for there in others), default=step.extent)


@cache
def term(kind: Kind) -> PixelTerm:
    """The loss for a kind of depth."""
    from core_rasterizer import PixelTerm

    expected = kind == "expected"
    return PixelTerm(
        SOURCE,
        ("shifted_rgb", "view_depth", *(("view_alpha",) if expected else ())),
        helpers=f"#define EXPECTED {int(expected)}\n{HELPERS}",
        in_rows=True,
        name="virtual_stereo",
    )


@hookimpl
def stereogs_register_regularizers(register: Register[VirtualStereo]) -> None:
    register("virtual_stereo", VirtualStereo)
