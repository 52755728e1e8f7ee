"""``fuselog simulate``: a log of a robot of which everything is known."""

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    name: Annotated[str | None, typer.Argument(help="The scenario.", show_default=False)] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the log (MCAP).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise; the same seed gives the same log.")] = 0,
    duration: Annotated[float, typer.Option(min=1, max=86400, help="In s.")] = 60.0,
    show_list: Annotated[bool, typer.Option("--list", help="List the scenarios and exit.")] = False,
) -> None:
    """Write the log of a scenario: its sensors, and the truth on /ground_truth."""
    from fuselog.replay.simulate import SCENARIOS  # noqa: PLC0415  slow to import
    from fuselog.replay.simulate import simulate as write  # noqa: PLC0415  slow to import

    if show_list:
        for scenario, make in SCENARIOS.items():
            typer.echo(f"{scenario:12}{make.__doc__}")
        return
    if name is None or name not in SCENARIOS:
        raise typer.BadParameter(f"one of: {', '.join(SCENARIOS)}", param_hint="NAME")
    if output is None:
        raise typer.BadParameter("where to write the log", param_hint="--output")
    messages = write(name, output, seed=seed, duration=duration)
    typer.echo(f"{messages} messages, {duration:g} s: {output}")
