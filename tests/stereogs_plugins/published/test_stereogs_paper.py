"""The published numbers are whole, in range, and agree with themselves."""

from __future__ import annotations

import math

import pytest

from tests.host import Numbers, paper_tables, protocol_names

TABLES = paper_tables("stereogs")


def test_every_protocol_has_its_published_rows() -> None:
    assert set(TABLES.results) == {*protocol_names()} - {"blender-8-dietnerf"}
    assert all({"3dgs", "stereogs", "stereogs_drop"} <= set(t) for t in TABLES.results.values())
    assert "StereoGS" in TABLES.source
    used = {method for rows in TABLES.results.values() for method in rows}
    assert used == set(TABLES.methods)


@pytest.mark.parametrize("protocol", TABLES.results)
def test_numbers_are_in_range(protocol: str) -> None:
    for triple in TABLES.results[protocol].values():
        if triple is not None:
            psnr, ssim, lpips = triple
            assert 10 < psnr < 30
            assert 0.4 < ssim < 1
            assert 0 < lpips < 0.5


def rows(table: str, protocol: str) -> list[Numbers | None]:
    return [row.results.get(protocol) for row in TABLES.ablations[table].rows]


@pytest.mark.parametrize("protocol", ["llff-3", "dtu-3"])
def test_each_ablation_holds_the_whole_method(protocol: str) -> None:
    whole = TABLES.results[protocol]["stereogs"]
    for name, ablation in TABLES.ablations.items():
        if any(protocol in row.results for row in ablation.rows):
            assert whole in rows(name, protocol), name


@pytest.mark.parametrize("protocol", ["llff-3", "dtu-3"])
def test_nothing_at_all_is_3dgs(protocol: str) -> None:
    first = TABLES.ablations["components"].rows[0]
    assert not any(first.setting.values())
    assert first.results[protocol] == TABLES.results[protocol]["3dgs"]
    assert len(TABLES.ablations["components"].rows) == 8


def test_the_whole_method_is_the_best_of_its_ablations() -> None:
    whole = TABLES.results["llff-3"]["stereogs"]
    assert whole is not None
    known = [t for name in TABLES.ablations for t in rows(name, "llff-3") if t is not None]
    assert max(triple[0] for triple in known) == whole[0]


def test_overhead_is_there_for_both_small_sets() -> None:
    assert set(TABLES.overhead) == {"llff-3", "dtu-3"}
    for methods in TABLES.overhead.values():
        assert set(methods) == {"3dgs", "fsgs", "mvpgs", "stereogs"}
        assert all(
            math.isfinite(cost.minutes) and cost.gaussians > 10_000 for cost in methods.values()
        )
