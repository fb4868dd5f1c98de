"""The pages of the site on the Python interfaces, from the docstrings of each public name."""

from __future__ import annotations

import inspect
from importlib import import_module

INTERFACES = {
    "stereogs.api": "What plugin authors import. **Stable from 0.1 on.**",
    "stereogs": "Train, open and render runs from Python. May change with a note in the changelog.",
    "stereogs.testing": "Tests of your own components. May change with a note in the changelog.",
    "core_rasterizer": (
        "The engine. `Camera`, `Device`, `Edit`, `GaussianReader`, `PixelTerm` and "
        "`Rendering` are stable from 0.1 on; the others may change with a note in the changelog."
    ),
    "registry.toolkit": "For components, as are the seven below. May change with a note in the changelog.",
    "registry.toolkit.cache": "",
    "registry.toolkit.drawing": "",
    "registry.toolkit.networks": "",
    "registry.toolkit.photos": "",
    "registry.toolkit.progress": "",
    "registry.toolkit.views": "",
    "registry.toolkit.web_page": "",
}
"""Modules, and what each is for and how stable it is."""


def pages() -> dict[str, str]:
    """Return the Markdown of each page by its name."""
    parents = [name for name in INTERFACES if not name.startswith("registry.toolkit.")]
    return {
        f"api/{parent}.md": "\n\n".join(
            _module(name) for name in INTERFACES if name == parent or _below(name, parent)
        )
        for parent in parents
    }


def _below(name: str, parent: str) -> bool:
    return parent == "registry.toolkit" and name.startswith("registry.toolkit.")


def _module(name: str) -> str:
    module = import_module(name)
    text = inspect.cleandoc(module.__doc__ or "").split("\n\n")[0]
    level = "##" if _below(name, "registry.toolkit") else "#"
    parts = [f"{level} `{name}`", text, INTERFACES[name]]
    for member in module.__all__:
        options = f"    options:\n      heading: {member}\n      heading_level: 3"
        parts.append(f"::: {name}.{member}\n{options}")
    return "\n\n".join(filter(None, parts))
