"""Keys depend on all inputs."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest
import torch

from registry.toolkit.cache import content_key, source_digest
from registry.toolkit.cache.keys import module_digest, package_digest
from tests.host import GROUP


def test_keys_depend_on_types_shapes_and_order() -> None:
    values = torch.arange(6.0)
    keys = [
        content_key(values),
        content_key(values.double()),
        content_key(values.reshape(2, 3)),
        content_key(values, None),
        content_key(None, values),
        content_key(values, "None"),
        content_key(b"None"),
        content_key("None"),
    ]
    assert len(set(keys)) == len(keys)
    assert content_key(values.clone()) == keys[0]


def test_digests_of_code_depend_on_its_file() -> None:
    assert source_digest(json) == source_digest(json.dumps)
    assert source_digest(json) != source_digest(logging)
    assert source_digest(json, logging) != source_digest(logging, json)


def test_the_key_contains_the_code_of_the_component() -> None:
    assert package_digest(json.JSONDecoder, GROUP) != package_digest(json.JSONEncoder, GROUP)
    assert package_digest(json.JSONDecoder, GROUP) == package_digest(json.JSONDecoder, GROUP)


@pytest.mark.parametrize("listed", ["top_level.txt", "RECORD"])
def test_the_key_contains_the_code_of_the_whole_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listed: str
) -> None:
    """A package of two top-level modules; a third module belongs to another package."""
    name = listed.partition(".")[0].lower()
    modules = (f"flat_{name}", f"flat_{name}_helper")
    for module in (*modules, f"other_{name}"):
        (tmp_path / f"{module}.py").write_text("FACTOR = 1\n")
    metadata = tmp_path / f"flat_{name}-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: flat-{name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[{GROUP}]\nflat = flat_{name}\n")
    lines = modules if listed == "top_level.txt" else [f"{module}.py,," for module in modules]
    (metadata / listed).write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(tmp_path)
    component = type("Flat", (), {"__module__": f"flat_{name}"})

    def digest() -> str:
        module_digest.cache_clear()
        return package_digest(component, GROUP)

    before = digest()
    (tmp_path / f"other_{name}.py").write_text("FACTOR = 2\n")
    assert digest() == before
    (tmp_path / f"flat_{name}_helper.py").write_text("FACTOR = 2\n")
    assert digest() != before
