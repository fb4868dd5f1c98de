"""What holds for all tests."""

import gc
import os

import pytest
import torch
from hypothesis import settings

# What pytest collects stays. Collecting garbage meanwhile would take a quarter of the time.
gc.disable()

settings.register_profile("no deadline", deadline=None)  # the machine may be busy
settings.load_profile("no deadline")

# As the command line does: torch's own threads would wait in a spin beside the OpenCL device's.
torch.set_num_threads(1)

# readline gives these to the processes that it starts, of pytest too; what the command line tells would be
# broken into lines of 80 columns.
for name in ("COLUMNS", "LINES"):
    os.environ.pop(name, None)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Collect garbage again during the tests, but skip the objects that exist already."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def _priors_answer_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test reads or fills the user's cache of prior answers; one that wants a cache names its own."""
    monkeypatch.setenv("STEREOGS_CACHE", "")


@pytest.fixture(autouse=True)
def _components_are_checked_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes take seconds to start; the test that needs them sets their hash seeds."""
    monkeypatch.setattr("registry.testing.processes.SEEDS", ())
