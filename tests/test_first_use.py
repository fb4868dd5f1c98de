"""Packages import nothing until one of their names is used."""

from __future__ import annotations

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = sorted(
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("core_rasterizer", "registry", "stereogs")
    for file in (ROOT / package).rglob("*.py")
    if "else:\n    __all__, __dir__, __getattr__ =" in file.read_text("utf-8")
)


@pytest.mark.parametrize("name", PACKAGES)
def test_everything_offered_is_there(name: str) -> None:
    package = importlib.import_module(name)
    for offered in package.__all__:
        assert getattr(package, offered) is getattr(package, offered)
    assert set(package.__all__) <= set(dir(package))


@pytest.mark.parametrize("name", PACKAGES)
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(AttributeError, match=rf"'{name}' has no attribute 'nonsense'"):
        importlib.import_module(name).nonsense  # noqa: B018


@pytest.mark.parametrize("name", [name for name in PACKAGES if name != "stereogs.api"])
def test_no_name_is_that_of_a_module(name: str) -> None:
    package = importlib.import_module(name)
    for offered in package.__all__:
        assert importlib.util.find_spec(f"{name}.{offered}") is None


def test_importing_loads_nothing_slow() -> None:
    code = f"import sys, {', '.join(PACKAGES)}; print('torch' in sys.modules)"
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert output.strip() == "False"
