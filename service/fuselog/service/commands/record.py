"""``fuselog record``: Zenoh into a log."""

import re
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuselog.service.console import print_json, stderr
from fuselog.service.signals import stop_and_snapshot

if TYPE_CHECKING:
    from fuselog.fusion.config.settings import RecordSettings
    from fuselog.replay.recording import RecordingStatus


def record(
    output: Annotated[Path, typer.Option("--output", "-o", help="The log to write (MCAP); nothing is overwritten.")],
    keys: Annotated[
        list[str] | None, typer.Argument(help="Topics or Zenoh keys, such as /imu/data or imu/**.  [default: **]")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Meet the service that has this configuration, and know its types."),
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Zenoh endpoint to connect to.  [default: tcp/127.0.0.1:7447]")
    ] = None,
    listen: Annotated[list[str] | None, typer.Option(help="Zenoh endpoint to listen on.")] = None,
    mode: Annotated[str, typer.Option(help="Role in Zenoh: peer or client.")] = "peer",
    exclude: Annotated[list[str] | None, typer.Option("--exclude", "-x", help="Topics or keys to leave out.")] = None,
    regex: Annotated[str, typer.Option("--regex", "-e", help="Only topics with this in their names.")] = "",
    compression: Annotated[str, typer.Option(help="lz4, zstd or none.")] = "lz4",
    durability: Annotated[
        str,
        typer.Option(help="none, flush (a killed process loses 1 s at most) or fsync (so does a power cut)."),
    ] = "flush",
    max_size: Annotated[str | None, typer.Option(help="Begin another file at this size, such as '1 GiB'.")] = None,
    max_duration: Annotated[str | None, typer.Option(help="Begin another file after this time, '10 min'.")] = None,
    snapshot: Annotated[
        str | None, typer.Option(help="Keep this time in memory, and write it at every signal USR1.")
    ] = None,
    duration: Annotated[float | None, typer.Option(min=0, help="Seconds to record.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON object every second and at the end.")] = False,
) -> None:
    """Record what is published on Zenoh until Ctrl-C or SIGTERM; exit code 3 when anything was lost.

    Several files, where asked for, are called NAME_0.mcap, NAME_1.mcap, ... Log times are those of arrival.
    """
    from fuselog.fusion import load_config  # noqa: PLC0415  slow to import
    from fuselog.replay.recording import Recording  # noqa: PLC0415  slow to import
    from fuselog.service.recording.record import options_of, status_json  # noqa: PLC0415  slow to import
    from fuselog.service.recording.record import record as run  # noqa: PLC0415  slow to import
    from fuselog.service.recording.selection import Selection, expressions  # noqa: PLC0415  slow to import
    from fuselog.service.streams import stream_types  # noqa: PLC0415  slow to import
    from fuselog.service.transport import Endpoints, open_session, visitor_endpoints  # noqa: PLC0415  slow to import

    settings = _settings(
        path=str(output),
        compression=compression,
        durability=durability,
        max_size=max_size,
        max_duration=max_duration,
        snapshot=snapshot,
    )
    selection = Selection(keys=expressions(keys or ["**"]), exclude=expressions(exclude or []), pattern=_pattern(regex))
    at, types = Endpoints(), stream_types({})
    if config is not None:
        known, source = load_config(config)
        at = visitor_endpoints(known.zenoh, source)
        types = stream_types({sensor.topic: sensor.type for sensor in known.sensors.values()})
    if connect or listen or config is None:
        default = [] if listen else ["tcp/127.0.0.1:7447"]
        at = replace(at, mode=mode, listen=listen or [], connect=connect or default)
    stop, wanted = stop_and_snapshot()
    with open_session(at, timeout_s=10.0) as session:
        recording = Recording(output, options_of(settings))
        stderr.print(f"recording {', '.join(selection.keys)} from {', '.join([*at.listen, *at.connect])}")
        started = time.monotonic()

        def report(status: "RecordingStatus") -> None:
            if as_json:
                seconds = round(time.monotonic() - started, 3)
                print_json({"schema": 1, "seconds": seconds, **status_json(status)})

        status = run(
            session,
            recording,
            selection,
            types=types,
            stop=stop,
            snapshot=wanted,
            duration_s=duration,
            report=report,
        )
    report(status)
    if not as_json:
        _print(status_json(status), time.monotonic() - started)
    if status.state == "stopped":
        stderr.print(f"error: the recording stopped: {status.reason}")
    if status.state == "stopped" or status.total.lossy:
        raise typer.Exit(3)


def _settings(**given: str | None) -> "RecordSettings":
    from pydantic import ValidationError  # noqa: PLC0415  slow to import

    from fuselog.fusion.config.settings import RecordSettings  # noqa: PLC0415  slow to import

    try:
        return RecordSettings.model_validate(given)
    except ValidationError as error:
        problem = error.errors()[0]
        name = str(problem["loc"][0]).replace("_", "-")
        raise typer.BadParameter(str(problem["msg"]), param_hint=f"--{name}") from error


def _pattern(text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise typer.BadParameter(str(error), param_hint="--regex") from error


def _print(status: dict[str, Any], seconds: float) -> None:
    """The ledger."""
    megabytes = status["bytes"] / 1e6
    typer.echo(f"recorded {status['written']} messages in {seconds:.2f} s: {megabytes:.2f} MB")
    wide = max([5, *(len(topic) for topic in status["topics"])])
    columns = ("received", "written", "queue", "disk", "limit", "missed")
    typer.echo(f"{'topic':{wide}}" + "".join(f"{name:>10}" for name in columns))
    for topic, account in [*status["topics"].items(), ("", status)]:
        counts = {**account, **account["dropped"]}
        typer.echo(f"{topic:{wide}}" + "".join(f"{counts[name]:>10}" for name in columns))
    expired = status["expired"]
    if expired:
        typer.echo(f"{expired} messages grew older than a snapshot holds, and none was asked for")
    for file in status["files"]:
        typer.echo(f"wrote {file}")
