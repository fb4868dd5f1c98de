"""Text without control characters, and names that can be shown and recorded."""

from __future__ import annotations

import re
import unicodedata

_INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's categories of control and format characters, lone surrogates and other line breaks."""

_CREDENTIALS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*://)[^\s/@'\"]+@")


def visible(text: str) -> str:
    """Escape control characters, as in \\x1b, so that names cannot send commands to the terminal.

    Line breaks and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(
        ascii(c)[1:-1] if c not in "\n\t" and unicodedata.category(c) in _INVISIBLE else c
        for c in text
    )


def without_credentials(text: str) -> str:
    """Replace user names and passwords in URLs, `scheme://user:password@host`, by ***."""
    return _CREDENTIALS.sub(r"\1***@", text)


def is_plain_name(name: object) -> bool:
    """Whether a name can be shown and recorded: a visible text of at most 200 characters on one line."""
    return (
        isinstance(name, str)
        and bool(name.strip())
        and len(name) <= 200
        and visible(name) == name
        and len(name.splitlines()) == 1
    )
