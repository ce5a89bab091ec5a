"""Text for terminals, without characters that would control a terminal; texts of errors."""

from typing import TextIO

ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\t\n"}
"""Escapes of control characters, for `str.translate`."""


def visible(text: str) -> str:
    """Return text in which every control character but tab and newline is visible."""
    return text.translate(ESCAPES)


def say(text: str, file: TextIO | None = None) -> None:
    """Print a text, all visible, to the standard output or a file."""
    print(visible(text), file=file, flush=True)


LONGEST = 2000
"""Characters of an error that are kept."""


def text_of(problem: BaseException) -> str:
    """Return the text of an error. An external policy's may raise one itself."""
    try:
        return str(problem)[:LONGEST]
    except BaseException:
        return "(its text raises an error)"


def reason_of(problem: BaseException) -> str:
    """Return the kind and the text of an error."""
    return f"{type(problem).__name__}: {text_of(problem)}"
