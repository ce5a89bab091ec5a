"""The command line `fbl-gym`: `parser.py` lists the commands, and each command has a file.

A command file has `run(arguments)`, which returns the exit status, and `add_arguments(parser)`.

A command's file is imported only when that command runs. What only some runs need, such as a
figure, is imported where it is used.
"""

from benchmarks.cli.parser import COMMANDS, EXTRAS, Parser, main, prepare

__all__ = ["COMMANDS", "EXTRAS", "Parser", "main", "prepare"]
