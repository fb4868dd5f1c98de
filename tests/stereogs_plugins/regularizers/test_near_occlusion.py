from __future__ import annotations

from functools import partial

import pytest

from stereogs_plugins.regularizers.near_occlusion import NearOcclusion
from tests.stereogs_plugins.building import at_depths, build, moment_with

haze = partial(at_depths, scale=0.2, opacity=0.6)


def test_only_what_is_nearer_than_freenerfs_sample_counts() -> None:
    # The scene reaches from 1 to 10: sample 20 of 128 is at 1 + 9 * 20 / 128 = 2.41.
    step, model = moment_with(haze(2.3, 2.5, 6.0))
    model.zero_gradients()
    loss = build(NearOcclusion).loss(step)
    loss.backward()
    alone, _ = moment_with(haze(2.3))
    assert float(loss.detach()) == pytest.approx(
        float(alone.rendering.alpha.detach().mean()), rel=1e-5
    )
    gradient = model.gradient("opacity_logits")
    assert gradient[0] > 0
    assert (gradient[1:] == 0).all()


def test_with_nothing_near_it_is_zero() -> None:
    step, _ = moment_with(haze(5.0, 6.0))
    assert float(build(NearOcclusion, share=10 / 128).loss(step)) == 0
