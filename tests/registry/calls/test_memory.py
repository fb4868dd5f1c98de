from __future__ import annotations

import mmap

import pytest

from registry import PluginError
from registry.calls import memory
from registry.calls.memory import MemoryLedger
from registry.system.memory import available_bytes, resident_bytes


def test_resident_bytes_grow_with_allocated_pages() -> None:
    # New pages from the system; what libraries allocate may be memory that earlier tests gave back.
    size, before = 100_000_000, resident_bytes()
    with mmap.mmap(-1, size) as pages:
        pages.write(bytes([1]) * size)
        assert 0.9 * size < resident_bytes() - before < 2.5 * size
    assert 1e6 < available_bytes() < 1e14


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
