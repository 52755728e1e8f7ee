"""``fuselog tune``: settings found from a log. One file a subcommand."""

import typer

from fuselog.service.commands.tune_gains import gains

tune = typer.Typer(help="Find settings from a log, and write them into a copy of the configuration.")
tune.callback()(lambda: None)  # a group, even of one command
tune.command()(gains)
