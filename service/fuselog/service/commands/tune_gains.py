"""``fuselog tune gains``: fixed gains found from a log."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fuselog.service.commands.truth_place import truth_fields, truth_place
from fuselog.service.console import print_json, progress, stderr
from fuselog.service.errors import OutputError

if TYPE_CHECKING:
    from fuselog.fusion import Plan
    from fuselog.replay.tune import Tuned
    from fuselog.replay.tune.gains import ReadTruth


def gains(
    log: Annotated[Path, typer.Argument(help="The MCAP log to tune by.")],
    config: Annotated[Path, typer.Option("--config", "-c", help="The fusion configuration (YAML).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write its copy with the new gains.")],
    by: Annotated[
        Literal["inverse_variance", "dare", "kappa", "learn"],
        typer.Option(help="Shares by noise; the filter's own steady gain; the best without cross gains; innovations."),
    ],
    form: Annotated[
        Literal["absorb", "state", "matrix"] | None,
        typer.Option(help="How to write them.", show_default="as it is, or the one that suits the method"),
    ] = None,
    noise: Annotated[
        Literal["given", "log"],
        typer.Option(help="Of sensors: as configured or in messages, or what three of one state say in the log."),
    ] = "given",
    kappa: Annotated[
        list[str] | None, typer.Option(metavar="STATE=NUMBER", help="How much a variance matters; one for each state.")
    ] = None,
    open_loop: Annotated[
        list[str] | None, typer.Option(metavar="STATE", help="A state that nothing measures; may be repeated.")
    ] = None,
    hold_out: Annotated[
        float, typer.Option(min=0.05, max=0.9, help="Share of the log, its end, to compare on and not tune by.")
    ] = 0.3,
    truth: Annotated[str | None, typer.Option(help="Where the truth is: LOG:TOPIC.")] = None,
    field: Annotated[
        list[str] | None, typer.Option(help="STATE=PATH, for truth of other message types; repeat for more.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find fixed gains from a log, compare them on the part held out, and write them into a copy."""
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.tune import tune_gains  # noqa: PLC0415  slow to import

    if output.resolve() == config.resolve():
        raise typer.BadParameter("the configuration itself is not written over", param_hint="--output")
    weights = dict(_weight(text) for text in kappa or [])
    if (by == "kappa") != bool(weights):
        raise typer.BadParameter("goes with --by kappa, once for each state: --kappa y=0.5", param_hint="--kappa")
    read = None if truth is None else _reader(truth, truth_fields(field or []))
    plan = load_plan(config)
    if not _finds_model(plan, output):
        reason = f"{plan.config.model.name} is beside the configuration: write the copy there too"
        raise typer.BadParameter(reason, param_hint="--output")
    with open_log(log) as opened, progress("tuning"):
        tuned = tune_gains(
            opened,
            plan,
            by=by,
            form=form,
            noise=noise,
            kappa=weights,
            open_loop=open_loop or [],
            hold_out=hold_out,
            truth=read,
        )
        losses = opened.losses
    _write(output, tuned.text)
    if as_json:
        print_json(tuned.to_json() | {"output": str(output)})
    else:
        _print(tuned, output)
    for loss in losses:
        stderr.print(f"lost: {log}: byte {loss.offset}: {loss.reason}")
    if losses:
        raise typer.Exit(3)


def _finds_model(plan: "Plan", output: Path) -> bool:
    """Whether a configuration in the place of the copy means the same model."""
    from fuselog.fusion.kernel.declared import LINEAR, ModelError, find_model  # noqa: PLC0415  slow to import

    if plan.config.model.name == LINEAR:
        return True
    try:
        return find_model(plan.config.model.name, output.parent) == plan.model
    except ModelError:
        return False


def _weight(text: str) -> tuple[str, float]:
    state, _, number = text.partition("=")
    try:
        weight = float(number)
    except ValueError:
        weight = -1.0
    if not 0 < weight < float("inf"):
        raise typer.BadParameter(f"expected STATE=NUMBER above 0, got {text!r}", param_hint="--kappa")
    return state, weight


def _reader(truth: str, fields: dict[str, str]) -> "ReadTruth":
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.truth import read_truth  # noqa: PLC0415  slow to import

    path, topic = truth_place(truth)

    def read(datum: Any) -> Any:
        with open_log(path) as log:
            return read_truth(log, topic, fields=fields, datum=datum)

    return read


def _write(output: Path, text: str) -> None:
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(output, error.strerror or str(error)) from error


def _print(tuned: "Tuned", output: Path) -> None:
    paces = ", ".join(f"{name} {pace.hz:g} Hz" for name, pace in tuned.seen.paces.items())
    typer.echo(f"by {tuned.by} at {paces}:")
    weights: Mapping[str, Any] = tuned.gain["weights"]
    wide = max(map(len, weights)) + 2
    for key, value in weights.items():
        row: Mapping[str, float] = {"": value} if tuned.form == "absorb" else value
        typer.echo(f"  {key:{wide}}" + "  ".join(f"{name} {weight:g}".strip() for name, weight in row.items()))
    typer.echo(f"{'on the held-out part':34}{'before':>12}{'after':>12}")
    for title, before, after in _rows(tuned):
        typer.echo(f"  {title:32}{before:>12.5g}{after:>12.5g}")
    if not tuned.accepted:
        typer.echo(f"not accepted: {tuned.reason}; the gains stay as they were")
    typer.echo(f"wrote {output}")


def _rows(tuned: "Tuned") -> list[tuple[str, float, float]]:
    """What is compared: title, before, after."""
    was, now = tuned.before, tuned.after
    if now is None:
        return []
    rows = [("prediction error", was.prediction_error, now.prediction_error)]
    for name in [name for name in was.sensors if name in now.sensors]:
        old, new = was.sensors[name], now.sensors[name]
        for number, rms in old.innovation_rms.items():
            rows.append((f"{name}.{number} innovation RMS", rms, new.innovation_rms[number]))
            rows.append((f"{name}.{number} lag-1 correlation", old.whiteness[number], new.whiteness[number]))
        rows.append((f"{name} NIS, {old.dof:g} expected", old.nis, new.nis))
    rows += [(f"{state} RMSE", rmse, (now.rmse or {})[state]) for state, rmse in (was.rmse or {}).items()]
    return rows
