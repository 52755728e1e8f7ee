"""``fuselog reprocess``: a log through a filter, offline."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fuselog.service.console import print_json, progress, stderr
from fuselog.service.limits import with_limits
from fuselog.service.memory import keep_freed_memory

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits


@with_limits
def reprocess(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG...", help="MCAP logs, or folders of rosbag2: fused as one.")
    ],
    config: Annotated[Path, typer.Option("--config", "-c", help="The fusion configuration (YAML).")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the track (MCAP).")] = None,
    order: Annotated[
        Literal["by_stamp", "as_received"] | None,
        typer.Option(help="Rows in stamp order (the best estimate), or as the live service publishes them."),
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Let every estimate know the whole log; in stamp order, optimal gain.")
    ] = False,
    spill: Annotated[
        Path | None, typer.Option(help="Folder for what smoothing puts aside; by default that for temporary files.")
    ] = None,
    rrd: Annotated[Path | None, typer.Option(help="Also write a Rerun recording of the output.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Fuse a log as fast as the machine allows; write estimates, odometry and a decision for every sample."""
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log, reprocess_to, smooth_to  # noqa: PLC0415  slow to import

    if rrd is not None and output is None:
        raise typer.BadParameter("it shows the output: give --output too", param_hint="--rrd")
    if smooth and order == "as_received":
        raise typer.BadParameter("smoothing is in the order of stamps", param_hint="--order")
    if spill is not None and not smooth:
        raise typer.BadParameter("only smoothing puts anything aside: give --smooth too", param_hint="--spill")
    plan = load_plan(config)
    if smooth and plan.config.gain.mode != "optimal":
        stderr.print(f"smoothing with the optimal gain; gain.mode {plan.config.gain.mode} is not used")
    keep_freed_memory()
    with open_log(*logs, limits=limits) as opened, progress("smoothing" if smooth else "fusing") as advance:
        if smooth:
            summary = smooth_to(opened, plan, output, spill=spill, advance=advance)
        else:
            summary = reprocess_to(opened, plan, output, order=order, advance=advance)
    if rrd is not None and output is not None:
        from fuselog.service.views.view import write_recording  # noqa: PLC0415  slow to import

        with open_log(*logs) as again:
            write_recording(rrd, outs=[output], log=again)
    if as_json:
        print_json(summary.to_json())
    else:
        _print(summary.to_json())
    for reason in dict.fromkeys(summary.passed_over):
        stderr.print(f"{summary.passed_over.count(reason)} commands in the log not followed: {reason}")
    for loss in summary.losses:
        stderr.print(f"lost: {loss}")
    if summary.lossy:
        raise typer.Exit(3)


def _print(summary: dict[str, Any]) -> None:
    rate = summary["messages"] / max(summary["seconds"], 1e-9)
    typer.echo(f"{summary['messages']} messages in {summary['seconds']:.2f} s ({rate:,.0f}/s)")
    names = ("received", "fused", "gated", "late", "duplicate", "skipped", "disabled")
    typer.echo(f"{'sensor':16}" + "".join(f"{name:>11}" for name in (*names, "invalid")))
    for sensor, account in summary["ledger"].items():
        invalid = sum(account["invalid"].values())
        typer.echo(f"{sensor:16}" + "".join(f"{account[name]:>11}" for name in names) + f"{invalid:>11}")
        why = ", ".join(f"{reason} {count}" for reason, count in account["invalid"].items() if count)
        if why:
            typer.echo(f"{'':16}  invalid: {why}")
    final = summary["final"]
    if final["t_ns"] is None:
        typer.echo("nothing was fused")
    else:
        typer.echo(f"final at {final['t_ns'] / 1e9:.3f} s: " + _state(final["state"]))
    if summary["output"]:
        typer.echo(f"wrote {summary['output']}")


def _state(state: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.4f}" for name, value in state.items())
