"""``fuselog serve``: a filter on live data."""

import signal
import threading
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from fuselog.service.console import stderr


def serve(
    config: Annotated[Path, typer.Argument(help="The fusion configuration (YAML).")],
    expose_http: Annotated[
        bool,
        typer.Option("--expose-http", help="Allow http.host to be reached by others, who are not asked who they are."),
    ] = False,
) -> None:
    """Fuse what comes on Zenoh, publish the estimates, and answer for health over HTTP.

    SIGTERM or Ctrl-C ends it after what has come is fused and published; Ctrl-C again ends it at once.
    SIGUSR1 writes a snapshot, where the configuration keeps one (record: snapshot).
    """
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.service.serving import serve as run  # noqa: PLC0415  slow to import
    from fuselog.service.transport import service_endpoints  # noqa: PLC0415  slow to import

    plan = load_plan(config)
    stop, snapshot = threading.Event(), threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    def ask(_number: int, _frame: FrameType | None) -> None:
        snapshot.set()

    signal.signal(signal.SIGUSR1, ask)
    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    at = service_endpoints(plan.config.zenoh)
    where = ", ".join([*at.listen, *at.connect])
    run(
        plan,
        stop=stop,
        started=lambda address: stderr.print(f"ready: filter {plan.config.id!r} on {where}, health at {address}"),
        expose_http=expose_http,
        snapshot=snapshot,
    )
