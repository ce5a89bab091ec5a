"""What several commands share."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console


def count(text: str) -> int:
    """A whole number, 1 or more, as an argument's type."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more, got {text!r}")
    return int(text)


def _file(text: str, *endings: str) -> Path:
    path = Path(text)
    if path.suffix not in endings:
        raise argparse.ArgumentTypeError(f"must end in {', '.join(endings[:-1])} or {endings[-1]}, got {text!r}")
    return path


def picture(text: str) -> Path:
    """A file that a plot can be written to, as an argument's type."""
    return _file(text, ".png", ".svg", ".pdf")


def film(text: str) -> Path:
    """A file that a film can be written to, as an argument's type."""
    return _file(text, ".mp4", ".gif")


def gain(text: str) -> tuple[str, Any]:
    """A gain and its value, one number or one for each joint, as an argument's type."""
    name, _, value = text.partition("=")
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if not name or len(numbers) not in (1, 2):
        raise argparse.ArgumentTypeError(f"must be such as kp=25, or kp=25,30 for the two joints, got {text!r}")
    return name, numbers[0] if len(numbers) == 1 else np.array(numbers)


def console() -> Console:
    """What tables are printed on; a file has no width of its own."""
    return Console(width=None if sys.stdout.isatty() else 132)


def command_line() -> str:
    """The command that this process was started with, as one could type it."""
    return " ".join(["fbl-gym", *sys.argv[1:]])


def add_store(parser: argparse.ArgumentParser) -> None:
    """The folder of results."""
    parser.add_argument(
        "--store", type=Path, default=Path("results/board"), metavar="DIR", help="the folder of results (results/board)"
    )
