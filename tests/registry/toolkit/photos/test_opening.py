"""Image files: supported formats only, complete, and of a plausible size."""

from __future__ import annotations

import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import Decoder, read_mask, stored_size
from registry.toolkit.photos.decoder import open_image

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 6\n%%EndComments\nshowpage\n%%EOF\n"


def flat_png(path: Path, width: int, height: int) -> Path:
    """A black image of any size, written row by row."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content))
            + kind
            + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )

    squeeze = zlib.compressobj(9)
    rows = b"".join(squeeze.compress(bytes(1 + width)) for _ in range(height)) + squeeze.flush()
    header = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )
    return path


def test_an_eps_file_starts_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = tmp_path / "started"
    ghostscript = tmp_path / "bin" / "gs"
    ghostscript.parent.mkdir()
    ghostscript.write_text(f"#!/bin/sh\ntouch {started}\n")
    ghostscript.chmod(0o755)
    monkeypatch.setenv("PATH", str(ghostscript.parent), prepend=os.pathsep)
    (tmp_path / "000.png").write_bytes(EPS)
    with Image.open(tmp_path / "000.png") as file:  # Pillow opens it by default
        assert file.format == "EPS"
    for read in (
        Decoder().read,
        stored_size,
        lambda path: read_mask(path, (8, 6)),
    ):
        with pytest.raises(SceneError, match="cannot be read"):
            read(tmp_path / "000.png")
    assert not started.exists()


@pytest.mark.parametrize("kind", ["GIF", "PPM", "TGA", "ICO"])
def test_other_formats_are_refused_under_any_name(kind: str, tmp_path: Path) -> None:
    Image.new("RGB", (16, 16)).save(tmp_path / "a.png", kind)
    with pytest.raises(SceneError, match="cannot be read"):
        Decoder().read(tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TIFF", "BMP"])
def test_supported_formats_are_read_under_any_name(kind: str, tmp_path: Path) -> None:
    Image.new("RGB", (16, 12), (100, 100, 100)).save(tmp_path / "a.png", kind)
    assert Decoder().read(tmp_path / "a.png").shape == (12, 16, 3)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TIFF", "BMP"])
def test_truncated_files_are_refused(kind: str, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (32, 48, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, kind)
    for part in (0.1, 0.5, 0.9):
        (tmp_path / "a.png").write_bytes(buffer.getvalue()[: int(part * len(buffer.getvalue()))])
        with pytest.raises(SceneError, match="cannot be read"):
            Decoder().read(tmp_path / "a.png")


def test_a_png_with_one_flipped_bit_is_refused(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (32, 48, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, "PNG", compress_level=0)
    content = bytearray(buffer.getvalue())
    content[len(content) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(SceneError, match="cannot be read"):
        Decoder().read(tmp_path / "a.png")


@pytest.mark.filterwarnings("ignore:Image size")  # Pillow's, from 89 megapixels on
def test_sizes_are_checked_before_decoding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Image.Image, "load")  # decoding would fail in another way
    huge = flat_png(tmp_path / "a.png", 12_000, 12_000)
    with pytest.raises(SceneError, match="more than 134 megapixels") as caught:
        Decoder().read(huge)
    assert caught.value.where == str(huge)
    bomb = flat_png(tmp_path / "b.png", 5000, 5000)
    with pytest.raises(SceneError, match="which no photograph has"):
        Decoder().read(bomb)


def test_a_small_flat_image_is_accepted(tmp_path: Path) -> None:
    assert stored_size(flat_png(tmp_path / "a.png", 4000, 3000)) == (4000, 3000)


def test_pipes_and_folders_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    (tmp_path / "b.png").mkdir()
    for name in ("a.png", "b.png", "c.png"):
        with (
            pytest.raises(SceneError, match="missing, or not a regular file"),
            open_image(tmp_path / name),
        ):
            pass


def test_a_tiff_with_missing_strips_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    noise = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    height = struct.pack("<HHII", 257, 4, 1, 6)
    content = path.read_bytes()
    assert content.count(height) == 1
    path.write_bytes(content.replace(height, struct.pack("<HHII", 257, 4, 1, 1_000_000)))
    with (
        pytest.raises(SceneError, match="8x1000000 pixels, but holds 48 of them") as caught,
        open_image(path),
    ):
        pass
    assert caught.value.where == str(path)


@pytest.mark.parametrize("kind", ["raw", "tiff_lzw", "jpeg", "packbits", "tiff_deflate"])
def test_tiffs_in_strips_are_read(tmp_path: Path, kind: str) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (300, 200, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.tif", compression=kind, strip_size=5000)
    with open_image(tmp_path / "a.tif") as file:
        found = np.asarray(file)
    assert found.shape == pixels.shape
    assert kind == "jpeg" or np.array_equal(found, pixels)
