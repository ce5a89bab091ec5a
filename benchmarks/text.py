"""Text for terminals: characters that would control a terminal are written as escapes."""

from typing import TextIO

ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\t\n"}
"""Escapes of control characters, for `str.translate`."""


def visible(text: str) -> str:
    """Return text in which every control character but tab and newline is visible."""
    return text.translate(ESCAPES)


def say(text: str, file: TextIO | None = None) -> None:
    """Print a text, all visible, to the standard output or a file."""
    print(visible(text), file=file, flush=True)
