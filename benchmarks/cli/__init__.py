"""The command line `fbl-gym`: `commands.toml` declares the commands, and each has a file.

A command's file has `run(arguments)`, which returns the exit status.

It is imported only when that command runs. What only some runs need, such as a
figure, is imported where it is used.
"""

from benchmarks.cli.parser import COMMANDS, EXTRAS, main, prepare

__all__ = ["COMMANDS", "EXTRAS", "main", "prepare"]
