"""Files of users: only regular files of a bounded size are opened."""

import codecs
import gzip
import io
import stat
import zlib
from pathlib import Path

#: Size of the largest file that is read, after unpacking [bytes].
LARGEST = 100_000_000


def read_bytes(path: str | Path, most: int = LARGEST) -> bytes:
    """Return the content of a regular file, unpacked if its name ends in .gz.

    Raises:
        OSError: the file is absent or cannot be read.
        ValueError: it is a folder, a pipe or a device, it is larger than `most` bytes, or its gzip
            data is damaged.
    """
    path = Path(path)
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe would wait for a writer
        raise ValueError(f"{path} must be a regular file, got a {'folder' if path.is_dir() else 'pipe or device'}")
    with path.open("rb") as file:
        try:
            content = gzip.GzipFile(fileobj=file).read(most + 1) if path.suffix == ".gz" else file.read(most + 1)
        except (EOFError, gzip.BadGzipFile, zlib.error) as problem:
            raise ValueError(f"{path} must be packed with gzip: {problem}") from None
    if len(content) > most:
        raise ValueError(f"{path} must have at most {most / 1e6:g} MB{' unpacked' * (path.suffix == '.gz')}")
    return content


def read_text(path: str | Path) -> str:
    """Return the text of a regular file, whose lines end in newlines on any machine.

    It is in UTF-8, or in UTF-16 with a byte order mark.
    """
    content = read_bytes(path)
    try:
        codec = "utf-16" if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8"
        return io.StringIO(content.decode(codec), newline=None).read()
    except UnicodeDecodeError as problem:
        raise ValueError(f"{path} must be text in UTF-8: {problem}") from None
