from __future__ import annotations

import torch

from stereogs_plugins.regularizers.stereo_depth.lazy_refresh import LazyRefresh

RIGHT = torch.rand(9, 13, 3, generator=torch.Generator().manual_seed(0))
DISPARITY = torch.full((9, 13), 5.0)


def test_an_answer_is_reused_until_the_picture_has_changed() -> None:
    refresh = LazyRefresh(0.02)
    assert refresh.find("a", RIGHT) is None
    refresh.keep("a", RIGHT, DISPARITY)
    assert refresh.find("a", RIGHT) is DISPARITY
    assert refresh.find("a", RIGHT + 0.019) is DISPARITY
    assert refresh.find("a", RIGHT + 0.021) is None
    assert refresh.find("b", RIGHT) is None
    assert (refresh.asked, refresh.reused) == (1, 2)


def test_pixels_beyond_the_last_whole_block_count() -> None:
    refresh = LazyRefresh(0.02)
    refresh.keep("a", RIGHT, DISPARITY)
    for rows, columns in ((slice(8, 9), slice(0, 13)), (slice(0, 9), slice(12, 13))):
        changed = RIGHT.clone()
        changed[rows, columns] += 0.5
        assert refresh.find("a", changed) is None


def test_slow_changes_add_up() -> None:
    """The comparison is with the picture that was matched, not with the one before."""
    refresh = LazyRefresh(0.02)
    refresh.keep("a", RIGHT, DISPARITY)
    found = [refresh.find("a", RIGHT + 0.009 * k) is not None for k in range(4)]
    assert found == [True, True, True, False]


def test_threshold_zero_always_asks() -> None:
    refresh = LazyRefresh(0.0)
    refresh.keep("a", RIGHT, DISPARITY)
    assert refresh.find("a", RIGHT) is None


def test_state_comes_back() -> None:
    refresh = LazyRefresh(0.02)
    for view in ("a.png", "with picture"):
        refresh.keep(view, RIGHT, DISPARITY)
    refresh.find("a.png", RIGHT)
    other = LazyRefresh(0.02)
    other.restore(refresh.state())
    assert (other.asked, other.reused) == (2, 1)
    for view in ("a.png", "with picture"):
        found = other.find(view, RIGHT)
        assert found is not None
        assert torch.equal(found, DISPARITY)
        assert other.find(view, RIGHT + 0.1) is None
