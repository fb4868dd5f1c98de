"""What the page of methods shows of a pipeline is in the pipeline."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "methods.md").read_text("utf-8")
SECTIONS = {
    title.lower().replace("²", "2"): text
    for title, text in re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    if title not in ("Measured", "Add yours")
}


def listed(section: Any) -> list[dict[str, Any]]:
    """A section's components, each as a mapping."""
    items = section if isinstance(section, list) else [section]
    return [{"use": item} if isinstance(item, str) else item for item in items]


def pipeline_file(name: str) -> Path:
    """Where the method's pipeline is: beside the other methods', or with the main pipelines."""
    folder = ROOT / "pipelines"
    beside = folder / "methods" / f"{name}.yaml"
    return beside if beside.exists() else folder / f"{name}.yaml"


def test_the_methods_have_a_section_each() -> None:
    assert {"3dgs", "dropgaussian", "mcmc", "binocular3dgs", "fsgs", "d2gs"} <= set(SECTIONS)


@pytest.mark.parametrize("name", SECTIONS)
def test_its_yaml_is_part_of_the_file(name: str) -> None:
    file = yaml.safe_load(pipeline_file(name).read_text("utf-8"))
    (source,) = re.findall(r"^```yaml\n(.*?)^```", SECTIONS[name], re.DOTALL | re.MULTILINE)
    for section, shown in yaml.safe_load(source).items():
        if section == "training":
            assert shown.items() <= file["training"].items()
            continue
        for item in listed(shown):
            matching = [one for one in listed(file[section]) if item.items() <= one.items()]
            assert matching, f"{section}: {item}"
