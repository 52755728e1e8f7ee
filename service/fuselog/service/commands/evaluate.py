"""``fuselog evaluate``: a track against the truth."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fuselog.service.commands.truth_place import truth_fields, truth_place
from fuselog.service.console import print_json


def evaluate(
    out: Annotated[Path, typer.Argument(help="The output log of fuselog reprocess.")],
    truth: Annotated[str, typer.Option("--truth", help="Where the truth is: LOG:TOPIC.")],
    field: Annotated[
        list[str] | None, typer.Option(help="STATE=PATH, for truth of other message types; repeat for more.")
    ] = None,
    where: Annotated[str | None, typer.Option(help="A Bool topic of the truth log; only rows it marks true.")] = None,
    topic: Annotated[
        str | None, typer.Option(help="Of several topics with estimates, such as fused/odom/smoothed; else the first.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare estimates with the truth at its stamps: RMSE by state, NEES, and NIS by sensor."""
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.evaluate import evaluate as compare  # noqa: PLC0415  slow to import
    from fuselog.replay.results import read_results  # noqa: PLC0415  slow to import
    from fuselog.replay.truth import only_where, read_truth  # noqa: PLC0415  slow to import

    path, true_topic = truth_place(truth)
    results = read_results(out, topic)
    with open_log(path) as log:
        true = read_truth(log, true_topic, fields=truth_fields(field or []), datum=results.datum)
        if where is not None:
            true = only_where(true, log, where)
    evaluation = compare(results, true).to_json()
    if as_json:
        print_json(evaluation)
    else:
        _print(evaluation)


def _print(evaluation: dict[str, Any]) -> None:
    typer.echo(f"compared at {evaluation['compared']} stamps")
    for state, value in evaluation["rmse"].items():
        typer.echo(f"  RMSE {state:12} {value:.4f}")
    for key, unit in (("position_rmse", "m"), ("attitude_rmse_deg", "deg")):
        if evaluation[key] is not None:
            typer.echo(f"  {key.replace('_', ' '):17} {evaluation[key]:.4f} {unit}")
    if evaluation["nees"] is not None:
        _consistency("NEES", evaluation["nees"])
    for sensor, nis in evaluation["nis"].items():
        _consistency(f"NIS {sensor}", nis)


def _consistency(title: str, numbers: dict[str, Any]) -> None:
    inside = 100 * numbers["inside_95"]
    mean, dof, n = numbers["mean"], numbers["dof"], numbers["n"]
    typer.echo(f"  {title:17} {mean:.3f} for {dof:g} degrees of freedom, {inside:.1f} % inside 95 %, {n} samples")
