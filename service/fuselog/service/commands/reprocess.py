"""``fuselog reprocess``: a log through a filter, offline."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fuselog.service.console import print_json, progress, stderr
from fuselog.service.limits import with_limits
from fuselog.service.memory import keep_freed_memory

if TYPE_CHECKING:
    from fuselog.fusion.captures import Captures
    from fuselog.replay.mcap_file.decompress import Limits
    from fuselog.replay.reprocess import Summary


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
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Where topics capture names: this filter; else all that the log has."),
    ] = None,
    rrd: Annotated[Path | None, typer.Option(help="Also write a Rerun recording of the output.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Fuse a log as fast as the machine allows; write estimates, odometry and a decision for every sample."""
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.fusion.captures import captures_of, chosen, plan_of  # noqa: PLC0415  slow to import
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
    summaries: dict[str, Summary] = {}
    with open_log(*logs, limits=limits) as opened:
        for captures in chosen(plan, opened.topics, only or []):
            one, to = plan_of(plan, captures), _file_of(output, captures)
            with progress("smoothing" if smooth else "fusing") as advance:
                if smooth:
                    summary = smooth_to(opened, one, to, spill=spill, advance=advance)
                else:
                    summary = reprocess_to(opened, one, to, order=order, advance=advance)
            summaries[one.config.id] = summary
    if rrd is not None and output is not None:
        from fuselog.service.views.view import write_recording  # noqa: PLC0415  slow to import

        with open_log(*logs) as again:
            outs = [summary.output for summary in summaries.values() if summary.output is not None]
            write_recording(rrd, outs=[Path(out) for out in outs], log=again)
    _tell(summaries, as_json=as_json, several=bool(captures_of(plan)))
    if any(summary.lossy for summary in summaries.values()):
        raise typer.Exit(3)


def _file_of(output: Path | None, captures: "Captures") -> Path | None:
    """Where the track of one filter goes."""
    from fuselog.fusion.captures import captured, fill  # noqa: PLC0415  slow to import

    if output is None:
        return None
    missing = [name for name, _ in captures if name not in captured([str(output)])]
    if missing:
        raise typer.BadParameter(f"each filter needs a file: put {{{missing[0]}}} into it", param_hint="--output")
    return Path(fill(str(output), captures))


def _tell(summaries: "dict[str, Summary]", *, as_json: bool, several: bool) -> None:
    """Results to stdout; commands that were not followed, and losses, to stderr."""
    told = {id: summary.to_json() for id, summary in summaries.items()}
    if as_json:
        print_json({"schema": 1, "filters": told} if several else next(iter(told.values())))
    for id, summary in told.items():
        if several and not as_json:
            typer.echo(f"filter {id}")
        if not as_json:
            _print(summary)
    for summary in summaries.values():
        for reason in dict.fromkeys(summary.passed_over):
            stderr.print(f"{summary.passed_over.count(reason)} commands in the log not followed: {reason}")
    for loss in next(iter(summaries.values())).losses:
        stderr.print(f"lost: {loss}")


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
