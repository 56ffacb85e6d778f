"""``loftscan sim``."""

from __future__ import annotations

import os
import sys

import typer

SETTINGS = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


def sim(context: typer.Context) -> None:
    """Serve a simulated station until Ctrl-C."""
    from loftscan.simulation import simulator_command

    sys.stdout.flush()
    command = simulator_command(context.args)
    # This process becomes the simulator: its signals and its exit code need no passing on.
    os.execv(command[0], command)
