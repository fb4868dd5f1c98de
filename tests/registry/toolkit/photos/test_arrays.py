"""NumPy files: headers are checked against the file size before anything is allocated."""

from __future__ import annotations

import io
import os
import pickle
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from registry import SceneError
from registry.toolkit.photos import read_array, read_arrays


def npy(array: np.ndarray, **changes: object) -> bytes:
    """An `.npy` file; `changes` replace fields of its header."""
    file = io.BytesIO()
    header = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
    np.lib.format.write_array_header_1_0(file, header | changes)
    return file.getvalue() + array.tobytes()


def test_arrays_come_back_as_they_were_written(tmp_path: Path) -> None:
    rows = np.arange(6.0).reshape(2, 3)
    columns = np.asfortranarray(rows)
    np.save(tmp_path / "a.npy", columns)
    np.savez_compressed(tmp_path / "b.npz", rows=rows, columns=columns, none=np.empty((0, 4)))
    assert np.array_equal(read_array(tmp_path / "a.npy", "it", ""), rows)
    found = read_arrays(tmp_path / "b.npz", ["rows", "columns", "none"], "it", "")
    assert np.array_equal(found["rows"], rows)
    assert np.array_equal(found["columns"], rows)
    assert found["none"].shape == (0, 4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(np.arange(3.0), shape=(4,)), "claims 32 bytes of numbers, but 24 follow"),
        (npy(np.arange(3.0), shape=(2,)), "claims 16 bytes of numbers, but 24 follow"),
        (npy(np.arange(3.0), shape=(1 << 60, 1 << 60)), "claims"),
        (npy(np.zeros(0), descr="|S0", shape=(10**9,)), "claims 0 bytes"),
        (b"\x93NUMPY\x01\x00\xff\xff", "EOF"),
        (b"", "EOF"),
    ],
)
def test_shapes_in_headers_are_checked(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("x.npy", content)
    for read in (
        lambda: read_array(tmp_path / "a.npy", "the file", "fix"),
        lambda: read_arrays(tmp_path / "b.npz", ["x"], "the file", "fix"),
    ):
        with pytest.raises(SceneError, match="the file cannot be read") as caught:
            read()
        assert message in caught.value.what


class Evil:
    """An object that runs code when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.path,)


def test_pickles_are_refused(tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    np.save(tmp_path / "a.npy", np.array([Evil(ran)], dtype=object))
    np.savez(tmp_path / "b.npz", x=np.array([Evil(ran)], dtype=object))
    (tmp_path / "c.npy").write_bytes(pickle.dumps(Evil(ran)))
    for read in (
        lambda: read_array(tmp_path / "a.npy", "it", ""),
        lambda: read_arrays(tmp_path / "b.npz", ["x"], "it", ""),
        lambda: read_array(tmp_path / "c.npy", "it", ""),
    ):
        with pytest.raises(SceneError):
            read()
    assert not ran.exists()


def test_a_zip_bomb_is_refused_before_unpacking(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", npy(np.zeros(10_000_000)))
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(SceneError, match="would unpack to 80,000,128 bytes, more than 67,108,864"):
        read_arrays(tmp_path / "a.npz", ["x"], "it", "")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.npy")
    for path in (tmp_path / "a.npy", Path("/dev/zero")):
        with pytest.raises(SceneError, match="it is not a regular file"):
            read_array(path, "it", "")
    with pytest.raises(SceneError, match="it is missing"):
        read_arrays(tmp_path / "b.npz", [], "it", "")
