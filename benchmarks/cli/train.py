"""The command `fbl-gym train`."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from benchmarks.cli.common import command_line
from benchmarks.rl.settings import add_arguments, from_arguments
from benchmarks.rl.train import train

__all__ = ["add_arguments", "run"]


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    settings = from_arguments(arguments)
    memory = f"-history-{arguments.history}" if arguments.history else ""
    context = "-context" if arguments.context else ""
    name = f"{settings.algorithm}-{settings.interface.action}{memory}{context}-{settings.seed}"
    folder = arguments.out or Path("runs") / name
    torch.set_num_threads(arguments.threads)
    train(settings, folder, command=command_line(), wandb=arguments.wandb)
    print(f"agent: {folder}")
    return 0
