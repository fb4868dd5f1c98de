"""Plugins load fast: heavy packages are imported by the method that needs them, not with the module."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = (
    "pycolmap",
    "cv2",
    "onnxruntime",
    "kornia",
    "skimage",
    "scipy.ndimage",
    "scipy.sparse.csgraph",
    "torch.utils.tensorboard",
    "wandb",
    "mlflow",
    "rerun",
)


def test_importing_every_plugin_imports_no_heavy_package() -> None:
    files = sorted((ROOT / "stereogs_plugins").rglob("*.py"))
    modules = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]
    code = f"""
import importlib, sys
import registry
before = set(sys.modules)  # what the host needs itself is not the plugins' doing
for name in {modules!r}:
    importlib.import_module(name.removesuffix(".__init__"))
print(*(name for name in {HEAVY!r} if name in set(sys.modules) - before))
print(*(name for name in ("pycolmap", "cv2", "onnxruntime", "kornia", "skimage") if name in sys.modules))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.split() == []
