"""The reference projection against gsplat's."""

from __future__ import annotations

import pytest

from tests.host import disagreement


def test_projection_and_its_gradients_are_those_of_gsplat() -> None:
    peer = pytest.importorskip(
        "gsplat.cuda._torch_impl", reason="`make gpu` installs gsplat", exc_type=ImportError
    )
    found = disagreement(peer, 300)
    assert set(found) == {
        *("places", "conics", "colours"),
        *(f"gradient of {name}" for name in ("means", "quaternions", "log_scales", "sh")),
    }
    assert max(found.values()) < 1e-12
