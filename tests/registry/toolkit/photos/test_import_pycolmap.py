"""Importing pycolmap before Pillow corrupts memory (two zlibs in one process)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

UNDISTORT = """
import numpy as np
from registry.toolkit.photos import Lens, undistort
bent = Lens(400, 400, 252, 189, 504, 378, "OPENCV", (-0.1, 0.01, 0.0, 0.0))
lens, straight = undistort(bent, np.full((378, 504, 3), 7, dtype=np.uint8), "here")
assert lens.is_pinhole and straight.shape[:2] == (lens.height, lens.width)
"""
IMPORT = """
from registry.toolkit.photos import import_pycolmap
import_pycolmap()
"""


@pytest.mark.parametrize("use", [UNDISTORT, IMPORT], ids=["a lens", "the import alone"])
def test_png_files_can_still_be_written_afterwards(use: str, tmp_path: Path) -> None:
    code = f"""
import numpy as np
{use}
from PIL import Image
pixels = np.random.default_rng(0).integers(0, 255, (378, 504, 3), dtype=np.uint8)
Image.fromarray(pixels).save({str(tmp_path / "noise.png")!r})
assert (np.asarray(Image.open({str(tmp_path / "noise.png")!r})) == pixels).all()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_log_level_is_never_lowered() -> None:
    code = """
from registry.toolkit.photos import import_pycolmap
levels = [import_pycolmap(level).logging.minloglevel for level in (2, 3, 2)]
assert levels == [2, 3, 3], levels
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


LOAD = """
import numpy as np
from PIL import Image
from registry.toolkit.photos import Decoder, Lens, LoadedPhotos, PosedPhoto, longest_side
Image.new("RGB", (504, 378)).save("black.png")
bent = Lens(400, 400, 252, 189, 504, 378, "OPENCV", (-0.1, 0.01, 0.0, 0.0))
photo = PosedPhoto("black", Path("black.png"), np.eye(4), bent, "here")
LoadedPhotos.load([photo, photo], Decoder(longest_side(504), "box"), [0, 1], [])
"""


@pytest.mark.proof
@pytest.mark.skipif(os.name != "posix", reason="Windows ends processes without a signal")
@pytest.mark.parametrize("handled", [True, False])
@pytest.mark.parametrize("use", [IMPORT, LOAD], ids=["the import alone", "photographs in threads"])
def test_the_handler_of_sigterm_is_kept(use: str, tmp_path: Path, *, handled: bool) -> None:
    handler = "lambda *_: sys.exit(7)" if handled else "signal.SIG_DFL"
    code = f"""
import os, signal, sys
from pathlib import Path
os.chdir({str(tmp_path)!r})
signal.signal(signal.SIGTERM, {handler})
{use}
os.kill(os.getpid(), signal.SIGTERM)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (7 if handled else -signal.SIGTERM, "")
