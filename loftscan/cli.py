"""What a person types: ``loftscan COMMAND``.

Exit codes: 0 done; 1 the work failed; 2 bad usage or bad input; 3 stopped by the operator; 4 a
device refused or was lost. Every message is one line that says what and what to do; a traceback
needs ``--debug``.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from loftscan.commands.bench import home, jog, profile, stop
from loftscan.commands.calibrate import calibrate
from loftscan.commands.compare import compare
from loftscan.commands.demo import demo
from loftscan.commands.devices import devices
from loftscan.commands.preview import preview
from loftscan.commands.reconstruct import reconstruct
from loftscan.commands.register import register
from loftscan.commands.scanning import scan
from loftscan.commands.scans import app as scans
from loftscan.commands.section import section
from loftscan.commands.simulating import SETTINGS, sim
from loftscan.commands.station import init

_STOPPED = 3

app = typer.Typer(
    help="Turn the slices of a scanning station into one watertight NURBS surface.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"loftscan {version('loftscan')}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Say it and end."),
    ] = False,
) -> None:
    """Turn the slices of a scanning station into one watertight NURBS surface."""


for each in (
    demo,
    init,
    devices,
    home,
    jog,
    stop,
    profile,
    calibrate,
    preview,
    scan,
    reconstruct,
    register,
    section,
    compare,
):
    app.command()(each)
app.command(context_settings=SETTINGS)(sim)
app.add_typer(scans, name="scans", context_settings={"help_option_names": ["-h", "--help"]})


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except SystemExit as ended:
        if ended.code == _STOPPED:
            # What was half made when the key was pressed complains when it goes: nobody's concern.
            sys.unraisablehook = lambda _: None
        raise


if __name__ == "__main__":
    main()
