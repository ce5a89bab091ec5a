"""Files that are complete or absent: each is written beside its place and renamed into it."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from benchmarks.text import visible


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a place to write a file to. The file is renamed to its path if the block succeeds."""
    for folder in reversed(path.parents):  # one by one, since `parents=True` ends at a thousand
        if not folder.exists():
            folder.mkdir(exist_ok=True)
    beside = path.with_name(f".unfinished-{uuid.uuid4().hex}{path.suffix[:20]}")
    try:
        yield beside
        with beside.open("rb+") as file:
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError as problem:
        problem.filename = problem.filename or str(path)  # that of a full disk names no file
        raise
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file as UTF-8. Control characters, and those that UTF-8 lacks, are escapes."""
    with replacing(path) as beside:
        beside.write_text(visible(text), encoding="utf-8", errors="backslashreplace", newline="\n")
