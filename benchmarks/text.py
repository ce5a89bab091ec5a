"""Text for terminals, without characters that would control a terminal; texts of errors."""

import contextlib
from collections.abc import Iterator
from typing import TextIO

_CONTROL = (*range(32), *range(127, 160), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
#: Escapes of control characters and of those that turn the order of text, for `str.translate`.
#:
#: JSON, TOML, Python and JavaScript read them as the same characters.
ESCAPES = {code: f"\\u{code:04x}" for code in _CONTROL if chr(code) not in "\t\n"}


def visible(text: str) -> str:
    """Return text in which every control character but tab and newline is visible as an escape."""
    return text.translate(ESCAPES)


def say(text: str, file: TextIO | None = None) -> None:
    """Print a text, all visible, to the standard output or a file."""
    print(visible(text), file=file, flush=True)


#: Characters of an error that are kept.
LONGEST = 2000


def text_of(problem: BaseException) -> str:
    """Return the text of an error. An external policy's may raise one itself."""
    try:
        return str(problem)[:LONGEST]
    except BaseException:
        return "(its text raises an error)"


def reason_of(problem: BaseException) -> str:
    """Return the kind and the text of an error."""
    return f"{type(problem).__name__}: {text_of(problem)}"


@contextlib.contextmanager
def refusing(words: str) -> Iterator[None]:
    """Turn each error of a block into a `ValueError` with these words, and its reason."""
    try:
        yield
    except Exception as problem:
        reason = f"it lacks {text_of(problem)}" if isinstance(problem, KeyError) else reason_of(problem)
        raise ValueError(f"{words}: {reason}") from None
