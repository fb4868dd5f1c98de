"""The notebook in docs/examples runs from its first cell to its last: `make notebook`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parent.parent / "docs" / "examples" / "first_scene.ipynb"


@pytest.mark.proof
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    import nbformat
    from nbclient import NotebookClient

    # Where the kernel and what it imports look for settings of the user's: nowhere.
    for variable in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.get("outputs") for cell in notebook.cells), "kept without what it printed"
    client = NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    client.execute()
    printed = [text_of(cell) for cell in notebook.cells if cell.cell_type == "code"]
    assert printed[0] == "3 photographs to train on, 4 to test with\n"
    first, last = (float(word) for word in printed[1].split(",")[0].split()[1::2])
    assert last < first
    assert printed[-1] == "True\n"
    assert any("image/png" in output.get("data", {}) for output in notebook.cells[5].outputs)


def text_of(cell: Any) -> str:
    return "".join(o["text"] for o in cell.outputs if o["output_type"] == "stream")
