"""``fuselog play``: logs onto Zenoh."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fuselog.service.console import print_json, stderr
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits
    from fuselog.replay.play import Status
    from fuselog.service.play.player import Report

Logs = Annotated[list[str], typer.Argument(metavar="LOG...", help="The logs to play, several as one.")]
Names = list[str] | None
_TIME = "Seconds of the log, @unix seconds, or ISO 8601."


@with_limits
def play(
    logs: Logs,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Meet the service that has this configuration.")
    ] = None,
    connect: Annotated[Names, typer.Option(help="Zenoh endpoint to connect to.  [default: tcp/127.0.0.1:7447]")] = None,
    listen: Annotated[Names, typer.Option(help="Zenoh endpoint to listen on.")] = None,
    mode: Annotated[str, typer.Option(help="Role in Zenoh: peer or client.")] = "peer",
    rate: Annotated[float, typer.Option("--rate", "-r", help="Speed; 0 plays as fast as subscribers take it.")] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="The same as --rate 0.")] = False,
    topic: Annotated[Names, typer.Option("--topic", "-t", help="Play only these topics.")] = None,
    regex: Annotated[
        str | None, typer.Option("--regex", "-e", help="Play topics whose whole name matches, beside --topic.")
    ] = None,
    exclude: Annotated[Names, typer.Option("--exclude", "-x", help="Leave these topics out.")] = None,
    exclude_regex: Annotated[str | None, typer.Option(help="Leave out topics whose whole name matches.")] = None,
    remap: Annotated[
        Names, typer.Option("--remap", "-m", metavar="/OLD:=/NEW", help="Publish a topic under another name.")
    ] = None,
    order: Annotated[
        Literal["log", "publish", "header"], typer.Option(help="Time by which messages are ordered and due.")
    ] = "log",
    start: Annotated[str, typer.Option("--start", "-s", metavar="TIME", help=f"Where to begin. {_TIME}")] = "0",
    duration: Annotated[float | None, typer.Option(min=0, help="Seconds of the log to play.")] = None,
    until: Annotated[str | None, typer.Option(metavar="TIME", help="Where to end, exclusive.")] = None,
    loop: Annotated[bool, typer.Option("--loop", "-l", help="Begin anew at the end, until stopped.")] = False,
    loop_from: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Where a loop goes back to.", show_default="--start")
    ] = None,
    loop_to: Annotated[
        str | None, typer.Option("--to", metavar="TIME", help="Where a loop ends; the same as --until.")
    ] = None,
    delay: Annotated[float, typer.Option(min=0, max=1e9, help="Seconds to wait before each beginning.")] = 0.0,
    paused: Annotated[bool, typer.Option("--start-paused", "-p", help="Wait for a key or a command.")] = False,
    clock: Annotated[
        str, typer.Option(metavar="HZ|off", help="Publish /clock, so often per second of the log.")
    ] = "off",
    wait_for_subscriber: Annotated[
        float, typer.Option("--wait-for-subscriber", min=0, help="Seconds to wait for a service; then play anyway.")
    ] = 10.0,
    name: Annotated[
        str | None, typer.Option(help="Of the player, for commands over Zenoh.", show_default="the log's")
    ] = None,
    no_control: Annotated[bool, typer.Option("--no-control", help="Take no commands over Zenoh.")] = False,
    no_keys: Annotated[bool, typer.Option("--no-keys", help="Take no commands from the keyboard.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Publish logs as they were recorded, and wait until services are done with them.

    Keys are the topics without the slash in front. Results of an earlier run in a log are not played. On a terminal,
    ? shows the keys.
    """
    from fuselog.fusion import load_config  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.play import CommandError, checked_rate, playable, source_of  # noqa: PLC0415  slow to import
    from fuselog.replay.play import remap as names_of  # noqa: PLC0415  slow to import
    from fuselog.service.play.control import player_name  # noqa: PLC0415  slow to import
    from fuselog.service.play.playing import Commands, Pace, clock_rate, range_of, run  # noqa: PLC0415  slow to import
    from fuselog.service.transport import Endpoints, visitor_endpoints  # noqa: PLC0415  slow to import

    at = Endpoints()
    if config is not None:
        known, written = load_config(config)
        at = visitor_endpoints(known.zenoh, written)
    if connect or listen or config is None:
        default = [] if listen else ["tcp/127.0.0.1:7447"]
        at = replace(at, mode=mode, listen=listen or [], connect=connect or default)
    with open_log(*logs, limits=limits) as log:
        try:
            if loop_to is not None and (until is not None or not loop):
                raise CommandError("--to is for loops, and the same as --until there")
            channels = playable(
                log, topics=topic or (), regex=regex, exclude=exclude or (), exclude_regex=exclude_regex
            )
            names = names_of(channels, remap or ())
            hz = clock_rate(clock, names)
            pace = Pace(rate=checked_rate(0 if fast else rate), paused=paused, delay_s=delay, clock_hz=hz)
            source = source_of(log, channels, order)
            span = range_of(
                source, start=start, until=until or loop_to, duration_s=duration, loop=loop, loop_from=loop_from
            )
        except CommandError as error:
            raise typer.BadParameter(str(error)) from error
        for of, count in source.by_log_time.items():
            stderr.print(f"{of}: {count} messages have no {order} time of this log's clock: played by log time")
        who = None if no_control else player_name(name or Path(logs[0]).stem)
        commands = Commands(name=who, keys=not no_keys)
        report, status = run(
            *(source, channels, names), span=span, pace=pace, commands=commands, at=at, wait_s=wait_for_subscriber
        )
        losses = log.losses
    _say(report, status, as_json=as_json)
    for loss in losses:
        stderr.print(f"lost: {loss}")
    if losses or not report.complete:
        raise typer.Exit(3)


def _say(report: "Report", status: "Status", *, as_json: bool) -> None:
    sent, processed, seconds = report.sent, report.processed, report.seconds
    if as_json:
        about = {"seconds": round(seconds, 6), "slipped_s": round(status.slipped_s, 6), "rounds": status.rounds}
        print_json({"schema": 1, "sent": sent, "processed": processed, **about})
        return
    rate = sum(sent.values()) / max(seconds, 1e-9)
    line = f"played {sum(sent.values())} messages of {len(sent)} topics in {seconds:.2f} s ({rate:,.0f}/s)"
    for topic, count in processed.items():
        if count < sent[topic]:
            stderr.print(f"lost: {topic}: {count} of {sent[topic]} messages were taken")
    typer.echo(f"{line}; services took {sum(processed.values())}" if processed else line)
    if status.slipped_s >= 0.1:
        stderr.print(f"slowed by {status.slipped_s:.1f} s in all: subscribers, the disk or the processor were busy")
