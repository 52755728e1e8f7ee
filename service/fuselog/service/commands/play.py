"""``fuselog play``: a log onto Zenoh."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.console import print_json, progress, stderr
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.decompress import Limits


@with_limits
def play(
    log: Annotated[Path, typer.Argument(help="The MCAP log to play.")],
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Meet the service that has this configuration.")
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Zenoh endpoint to connect to.  [default: tcp/127.0.0.1:7447]")
    ] = None,
    listen: Annotated[list[str] | None, typer.Option(help="Zenoh endpoint to listen on.")] = None,
    mode: Annotated[str, typer.Option(help="Role in Zenoh: peer or client.")] = "peer",
    rate: Annotated[float, typer.Option(min=0, help="Speed; 0 plays as fast as subscribers take it.")] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="The same as --rate 0.")] = False,
    topic: Annotated[list[str] | None, typer.Option("--topic", "-t", help="Play only these topics.")] = None,
    exclude: Annotated[list[str] | None, typer.Option("--exclude", "-x", help="Leave these topics out.")] = None,
    start: Annotated[float, typer.Option(min=0, help="Seconds of the log to skip.")] = 0.0,
    duration: Annotated[float | None, typer.Option(min=0, help="Seconds of the log to play.")] = None,
    wait_for_subscriber: Annotated[
        float, typer.Option("--wait-for-subscriber", min=0, help="Seconds to wait for a service; then play anyway.")
    ] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Publish a log as it was recorded, and wait until services are done with it.

    Keys are the topics without the slash in front. Results of an earlier run in the log are not played.
    """
    from fuselog.fusion import load_config  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.play import play as messages_of  # noqa: PLC0415  slow to import
    from fuselog.replay.play import playable  # noqa: PLC0415  slow to import
    from fuselog.service.player import Player  # noqa: PLC0415  slow to import
    from fuselog.service.transport import Endpoints, open_session, visitor_endpoints  # noqa: PLC0415  slow to import

    at = visitor_endpoints(load_config(config)[0].zenoh) if config is not None else Endpoints()
    if connect or listen or config is None:
        default = [] if listen else ["tcp/127.0.0.1:7447"]
        at = Endpoints(mode=mode, listen=listen or [], connect=connect or default)
    with open_log(log, limits=limits) as opened:
        channels = playable(opened, topics=topic or (), exclude=exclude or ())
        first, last = opened.time_range or (0, 0)
        with open_session(at, timeout_s=max(wait_for_subscriber, 1.0)) as session, progress("playing") as advance:
            player = Player(session, channels)
            if not player.wait_for_subscriber(wait_for_subscriber):
                stderr.print(f"nobody subscribes to any topic of {log}; playing anyway")
            pace = None if fast or rate == 0 else rate
            messages = messages_of(opened, channels, rate=pace, start_s=start, duration_s=duration)
            report = player.play(messages, lambda played: advance(played.log_time - first, max(last - first, 1)))
    if as_json:
        counts = {"sent": report.sent, "processed": report.processed}
        print_json({"schema": 1, **counts, "seconds": round(report.seconds, 6)})
    else:
        _print(report.sent, report.processed, report.seconds)
    for loss in opened.losses:
        stderr.print(f"lost: {log}: byte {loss.offset}: {loss.reason}")
    if opened.losses or not report.complete:
        raise typer.Exit(3)


def _print(sent: dict[str, int], processed: dict[str, int], seconds: float) -> None:
    rate = sum(sent.values()) / max(seconds, 1e-9)
    line = f"played {sum(sent.values())} messages of {len(sent)} topics in {seconds:.2f} s ({rate:,.0f}/s)"
    for topic, count in processed.items():
        if count < sent[topic]:
            stderr.print(f"lost: {topic}: {count} of {sent[topic]} messages were taken")
    typer.echo(f"{line}; services took {sum(processed.values())}" if processed else line)
