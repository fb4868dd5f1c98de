"""Damage a file, reproducibly: a number determines the damage on all machines."""

from __future__ import annotations

import io
import random
import re
import struct
import zipfile
from functools import cache

OUTSIDE = "outside.png"
"""An image outside the data set that must never be read; its color occurs in no photograph."""
TEXTS = (".json", ".txt", ".yaml", ".ply")
"""Suffixes of files that are also damaged as text, word by word."""

_NUMBERS = ("nan", "NaN", "inf", "-Infinity", "1e400", "-1", "0", "1e300", "9" * 25, "1e-300", "")
_NAMES = (
    f"../{OUTSIDE}",
    f"x/../../{OUTSIDE}",
    "/etc/hostname",
    "..",
    ".",
    "a\0b",
    "C:\\x",
    "é" * 300,
)
_DOUBLES = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300, 1e18)


def damage(data: bytes, file: str, randomness: random.Random) -> bytes:
    """One to three mutations of a file; members of an archive are damaged within it."""
    if file.endswith(".npz") and randomness.random() < 0.8:
        return _damage_member(data, randomness)
    for _ in range(randomness.choice((1, 1, 1, 2, 3))):
        if file.endswith(TEXTS) and randomness.random() < 0.7:
            data = _damage_text(data, randomness)
        else:
            data = _damage_bytes(data, randomness)
    return data


@cache
def _members(data: bytes) -> tuple[tuple[str, bytes], ...]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def _damage_member(data: bytes, randomness: random.Random) -> bytes:
    """Rewrite an archive with valid checksums, so that the damage reaches the numbers."""
    members = dict(_members(data))
    name = randomness.choice(list(members))
    members[name] = _damage_bytes(members[name], randomness)
    if randomness.random() < 0.1:
        del members[randomness.choice(list(members))]
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return result.getvalue()


def _damage_text(data: bytes, randomness: random.Random) -> bytes:
    """Replace or swap numbers and names."""
    text = data.decode("utf-8", "surrogateescape")
    tokens = re.split(r"""([\s,:"\[\]{}]+)""", text)
    words = [k for k in range(0, len(tokens), 2) if tokens[k]]
    if not words:
        return data
    chosen = randomness.choice(words)
    kind = randomness.random()
    if kind < 0.4:
        tokens[chosen] = randomness.choice(_NUMBERS)
    elif kind < 0.6:
        named = [k for k in words if re.search(r"\.(png|JPG)$|/r_\d+$", tokens[k])] or words
        tokens[randomness.choice(named)] = randomness.choice(_NAMES)
    elif kind < 0.8:
        other = randomness.choice(words)
        tokens[chosen], tokens[other] = tokens[other], tokens[chosen]
    elif kind < 0.9:
        tokens[chosen] = ""
    else:
        tokens[chosen] = f"{tokens[chosen]}{randomness.choice(('0', '1', 'e9', '.', '-'))}"
    return "".join(tokens).encode("utf-8", "surrogateescape")


def _damage_bytes(data: bytes, randomness: random.Random) -> bytes:
    """Flip bits, cut, insert, repeat, swap, or write a special number or name."""
    result = bytearray(data)
    if not result:
        return randomness.randbytes(8)
    place = randomness.randrange(len(result))
    length = randomness.choice((1, 4, 8, 64))
    kind = randomness.randrange(7)
    if kind == 0:
        for _ in range(randomness.choice((1, 2, 8))):
            result[randomness.randrange(len(result))] ^= 1 << randomness.randrange(8)
    elif kind == 1:
        del result[place:]
    elif kind == 2:
        del result[place : place + length]
    elif kind == 3:
        result[place:place] = randomness.randbytes(length)
    elif kind == 4:
        result[place : place + 8] = struct.pack("<d", randomness.choice(_DOUBLES))
    elif kind == 5:
        other = randomness.randrange(len(result))
        first, second = result[place : place + length], result[other : other + length]
        result[place : place + length], result[other : other + length] = second, first
    else:
        names = [match.span() for match in re.finditer(rb"IMG_\d+\.JPG", data)]
        if names:
            start, stop = randomness.choice(names)
            result[start:stop] = randomness.choice(_NAMES).encode()
        else:
            result[place : place + 8] = struct.pack("<Q", randomness.choice((0, 2**63, 2**31, 7)))
    return bytes(result)
