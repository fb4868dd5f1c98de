from __future__ import annotations

import pytest
import torch

from registry.triangulation import triangulate
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.data import data_folder
from tests.stereogs_plugins.building import build


def test_error_and_angle_are_limits() -> None:
    views = build(ProceduralScene, width=168, height=126).load().train
    loose, strict = (
        triangulate(views, max_reprojection_error=error, min_angle=1.5, seed=0)
        for error in (4.0, 0.5)
    )
    assert strict.errors.max() <= 0.5 < loose.errors.max()
    assert (loose.seen_by.sum(dim=1) >= 2).all()
    wide = triangulate(views, max_reprojection_error=4.0, min_angle=12.0, seed=0)
    assert 0 < len(wide.positions) < len(loose.positions)


@pytest.mark.proof
@pytest.mark.parametrize(("name", "least"), [("llff_fern", 550), ("llff_flower", 1500)])
def test_three_real_photographs_give_points(name: str, least: int) -> None:
    scene = build(LLFFScene, path=data_folder(name)).load()
    found = triangulate(scene.train, max_reprojection_error=2.0, min_angle=1.5, seed=0)
    assert len(found.positions) > least
    assert found.errors.mean() < 0.5
    assert scene.points is not None  # the data set's own points, from all photographs
    distance = torch.cdist(found.positions, scene.points.positions).amin(dim=1)
    assert distance.median() < 0.02 * scene.bounds[1]
