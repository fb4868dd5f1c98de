from __future__ import annotations

import pytest

from registry import PluginError
from registry.calls import memory
from registry.calls.memory import MemoryLedger


class Holder:
    """Stands for a process: returns the memory that it holds."""

    held = 1000

    def __call__(self) -> int:
        return self.held


def call(ledger: MemoryLedger, who: str, process: Holder, more: int) -> None:
    with ledger.watching(who):
        process.held += more


def test_the_component_that_allocated_most_is_refused_at_the_limit() -> None:
    process = Holder()
    ledger = MemoryLedger(limit=2000, resident=process)
    for _ in range(9):
        call(ledger, "hog", process, 100)
        call(ledger, "fluctuating", process, 50)
        call(ledger, "fluctuating", process, -50)
    call(ledger, "modest", process, 101)
    with pytest.raises(PluginError, match="memory runs out") as caught:
        call(ledger, "hog", process, 1)
    assert "autograd" in caught.value.fix


def test_growth_outside_calls_is_not_blamed_on_plugins() -> None:
    process = Holder()
    ledger = MemoryLedger(limit=2000, resident=process)
    call(ledger, "modest", process, 100)
    process.held += 5000
    call(ledger, "modest", process, 100)


def test_the_limit_is_a_share_of_the_available_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 1000.0)
    process = Holder()
    ledger = MemoryLedger(resident=process)
    call(ledger, "hog", process, 899)
    with pytest.raises(PluginError):
        call(ledger, "hog", process, 2)
