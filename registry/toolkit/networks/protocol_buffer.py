"""Protocol buffers, as far as is needed to look into one: fields of a number and a value or a length."""

from __future__ import annotations

from collections.abc import Iterator

_FIXED_SIZES = {1: 8, 5: 4}
_LENGTH, _NUMBER = 2, 0


def fields(part: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """The numbers and the parts of a message, by field.

    Raises:
        ValueError, IndexError: it is cut off, or none.
    """
    place = 0
    while place < len(part):
        tag, place = _number(part, place)
        field, kind = tag >> 3, tag & 7
        if kind == _NUMBER:
            value, place = _number(part, place)
            yield field, value
            continue
        size, place = _number(part, place) if kind == _LENGTH else (_FIXED_SIZES.get(kind), place)
        if size is None or place + size > len(part):
            raise ValueError(f"field {field} of kind {kind} does not fit")
        yield field, part[place : place + size]
        place += size


def whole_numbers(value: int | memoryview) -> list[int]:
    """Of a field that repeats: one, or several packed into a part.

    Raises:
        ValueError, IndexError: the part is cut off.
    """
    if not isinstance(value, memoryview):
        return [value]
    numbers, place = [], 0
    while place < len(value):
        number, place = _number(value, place)
        numbers.append(number)
    return numbers


def _number(part: memoryview, place: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and where it ends."""
    value = shift = 0
    while shift < 70:
        byte = part[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
        shift += 7
    raise ValueError("a number of more than ten bytes")
