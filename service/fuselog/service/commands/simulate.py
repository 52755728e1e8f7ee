"""``fuselog simulate``: a log of a system of which everything is known."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from fuselog.replay.scenarios import Scenario


def simulate(
    name: Annotated[str | None, typer.Argument(help="The scenario.", show_default=False)] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the log (MCAP).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise; the same seed gives the same log.")] = 0,
    duration: Annotated[
        float | None, typer.Option(min=1, max=86400, help="In s.", show_default="the scenario's")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=NUMBER", help="Change a parameter; may be repeated.")
    ] = None,
    show_list: Annotated[bool, typer.Option("--list", help="List the scenarios and exit.")] = False,
) -> None:
    """Write the log of a scenario: its sensors and inputs, and the truth on /ground_truth."""
    from fuselog.replay.scenarios import ParameterError  # noqa: PLC0415  slow to import
    from fuselog.replay.simulate import SCENARIOS  # noqa: PLC0415  slow to import
    from fuselog.replay.simulate import simulate as write  # noqa: PLC0415  slow to import

    if show_list:
        _print_list(SCENARIOS)
        return
    if name is None or name not in SCENARIOS:
        raise typer.BadParameter(f"one of: {', '.join(SCENARIOS)}", param_hint="NAME")
    if output is None:
        raise typer.BadParameter("where to write the log", param_hint="--output")
    parameters = dict(_change(text) for text in changes or [])
    try:
        messages = write(name, output, seed=seed, duration=duration, parameters=parameters)
    except ParameterError as error:
        raise typer.BadParameter(str(error), param_hint="--set") from error
    typer.echo(f"{messages} messages, {duration or SCENARIOS[name].duration:g} s: {output}")


def _change(text: str) -> tuple[str, float]:
    name, equals, number = text.partition("=")
    try:
        if equals:
            return name.strip(), float(number)
    except ValueError:
        pass
    raise typer.BadParameter(f"{text!r} is not a parameter and a number, like sigma_xi=0.2", param_hint="--set")


def _print_list(scenarios: "Mapping[str, Scenario[Any]]") -> None:
    wide = max(map(len, scenarios))
    source = max(len(scenario.source) for scenario in scenarios.values())
    typer.echo(f"{'scenario':{wide}}  {'source':{source}}  {'s':>5}  what, and its parameters (--set)")
    for name, scenario in scenarios.items():
        typer.echo(f"{name:{wide}}  {scenario.source:{source}}  {scenario.duration:>5g}  {scenario.title}")
        given = "  ".join(f"{parameter}={value}" for parameter, value in scenario.quantities.items())
        typer.echo(f"{'':{wide}}    {given}")
