"""What holds for all tests."""

import pytest
import torch

# As the command line does: torch's own threads would wait in a spin beside the OpenCL device's.
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _priors_answer_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test reads or fills the user's cache of prior answers; one that wants a cache names its own."""
    monkeypatch.setenv("STEREOGS_CACHE", "")
