"""Every shipped component has an entry point of its own name: naming one imports no other."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

from tests.host import GROUP, Plugins, offered_name


def test_each_entry_offers_what_it_is_named_after() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))
    written = project["project"]["entry-points"][GROUP]
    entries = [EntryPoint(name, module, GROUP) for name, module in written.items()]
    plugins = Plugins(entries)
    offers = plugins.all()
    assert plugins.broken == {}
    assert plugins.conflicts() == []
    assert sorted(offer.plugin for offer in offers) == sorted(written)
    assert all(
        offer.name == offered_name(entry)
        for offer in offers
        for entry in entries
        if entry.name == offer.plugin
    )
