"""``fuselog demo``: see what fusion does, without any data."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fuselog.service.console import print_json, progress


def demo(
    folder: Annotated[Path, typer.Option(help="Where to leave logs, configurations and the recording.")] = Path(
        "fuselog-demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of the noise; the same seed gives the same logs.")] = 1,
    duration: Annotated[float, typer.Option(min=5, max=3600, help="Of the drive, in s.")] = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Simulate a robot along a wall, fuse its sensors in two ways, compare with the truth."""
    with progress("the first run compiles, which takes a while") as step:
        from fuselog.service.demo import run_demo  # noqa: PLC0415  slow to import

        result = run_demo(folder, seed=seed, duration=duration, step=step).to_json()
    if as_json:
        print_json(result)
    else:
        _print(result)


def _print(result: dict[str, Any]) -> None:
    typer.echo(f"{'RMS error':20}{'y':>12}{'yaw':>14}")
    for method, errors in result["rmse"].items():
        typer.echo(f"{method:20}{_number(errors['y'], 'm'):>12}{_number(errors['yaw'], 'rad'):>14}")
    typer.echo("\nDoes the filter know its errors? Means, and what they should be near:")
    for way, evaluation in result["evaluation"].items():
        parts = [("NEES", evaluation["nees"]), *((f"NIS {name}", nis) for name, nis in evaluation["nis"].items())]
        found = "".join(f"   {title} {part['mean']:.2f} ({part['dof']:g})" for title, part in parts)
        typer.echo(f"fused, {way:13}{found}")
    typer.echo("\nLeft behind:")
    for path in result["files"]:
        typer.echo(f"  {path}")
    typer.echo(f"\nSee it:  {result['next']}")


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.4f} {unit}"
