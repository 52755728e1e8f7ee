"""The command line: one command a file in ``commands``; errors become one line and an exit code here, nowhere else."""

import importlib
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated, Any

import typer

from fuselog.schemas.errors import ConfigError, FuselogError

OK, FAILED, USAGE, LOSSY, INTERRUPTED = 0, 1, 2, 3, 130
# In the order of the help.
COMMANDS = (
    "demo",
    "simulate",
    "check",
    "info",
    "export",
    "doctor",
    "recover",
    "reprocess",
    "play",
    "record",
    "serve",
    "verify",
    "token",
    "evaluate",
    "tune",
    "view",
    "warm_up",
    "articles",
)


def make_app() -> typer.Typer:
    """The command line with all commands."""
    app = typer.Typer(
        name="fuselog",
        help="Sensor-log replay and data fusion: the same estimates live on Zenoh and offline on MCAP.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name in COMMANDS:
        command: Callable[..., Any] = getattr(importlib.import_module(f"fuselog.service.commands.{name}"), name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name.replace("_", "-"))(command)
    return app


def main() -> None:
    """Run the command line; exits 0 ok, 1 failed, 2 usage or config, 3 data loss, 4 differs, 130 interrupted."""
    escape: Callable[..., None] | None = getattr(sys.stdout, "reconfigure", None)
    if escape is not None:
        escape(errors="backslashreplace")  # names of files need not be text
    try:
        make_app()()
    except ConfigError as error:
        sys.exit(_report(error, USAGE))
    except FuselogError as error:
        sys.exit(_report(error, FAILED))
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _report(error: FuselogError, code: int) -> int:
    for line in str(error).splitlines():
        sys.stderr.write(f"error: {line}\n")
    return code


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"fuselog {version('fuselog')}\n")
        raise typer.Exit


def _root(
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass
