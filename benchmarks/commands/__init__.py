"""The commands of `fbl-gym`, one file each: `add_arguments(parser)` and `run(arguments)`, which returns the exit status.

A command's file is imported only when it is asked for, so each imports what it needs at its head.
"""
