from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from benchmarks.left_out import Variant, VariantScore, table
from benchmarks.left_out_scenes import half, thinned
from core_rasterizer import Camera
from registry import Scene, View


def scene_of(count: int) -> Scene:
    """Views of 6 x 4 pixels; their numbers are their colours."""
    camera = Camera.centered(torch.eye(4), 50.0, 6, 4)
    views = [View(str(i), camera, torch.full((4, 6, 3), i / count)) for i in range(count)]
    return Scene("views", tuple(views), (View("test", camera, torch.ones(4, 6, 3)),), (1.0, 9.0))


@pytest.mark.parametrize(
    ("count", "left_out"), [(2, "1"), (3, "1"), (6, "1 4"), (8, "1 4 7"), (9, "1 4 7")]
)
def test_every_third_view_is_left_out_and_test_views_are_dropped(count: int, left_out: str) -> None:
    scene = thinned(scene_of(count))
    assert [view.name for view in scene.test] == left_out.split()
    assert sorted([v.name for v in (*scene.train, *scene.test)]) == [str(i) for i in range(count)]


def test_a_point_stays_where_it_is_in_a_half_sized_photograph() -> None:
    scene = scene_of(3)
    image = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0))
    scene = replace(scene, train=(replace(scene.train[0], image=image), *scene.train[1:]))
    small, view = half(scene).train[0], scene.train[0]
    assert small.image.shape == (2, 3, 3)
    torch.testing.assert_close(small.image[1, 2], image[2:4, 4:6].mean(dim=(0, 1)))
    point = torch.tensor([[0.1, -0.2, 5.0]], dtype=torch.float64)
    for whole, halved in zip(
        view.camera.project(point)[:2], small.camera.project(point)[:2], strict=True
    ):
        torch.testing.assert_close(halved, whole / 2)


def test_a_table_compares_with_the_first_variant_case_by_case() -> None:
    first, second = Variant.parse("plain"), Variant.parse("more: a.b=1; c=[2, 3]")
    assert second.overrides == ("a.b=1", "c=[2, 3]")

    def record(case: str, psnr: float) -> VariantScore:
        return VariantScore(case, "", "0", 0, psnr, 0.5, 30.0, 1000, 1.0, 2.0)

    results = [
        (first, record("a", 20.0)),
        (second, record("a", 20.5)),
        (first, record("b", 10.0)),
        (second, record("b", 9.0)),
    ]
    assert "| more | 14.75 | 0.5000 | -0.250 | +0.50 -1.00 |" in table(results, [first, second])
