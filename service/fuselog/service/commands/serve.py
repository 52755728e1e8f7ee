"""``fuselog serve``: filters on live data."""

from pathlib import Path
from typing import Annotated

import typer

from fuselog.service.console import stderr
from fuselog.service.signals import stop_and_snapshot


def serve(
    configs: Annotated[list[Path], typer.Argument(help="Fusion configurations (YAML), each of one filter or more.")],
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
    from fuselog.service.live.serving import serve as run  # noqa: PLC0415  slow to import
    from fuselog.service.transport import service_endpoints  # noqa: PLC0415  slow to import

    plans = [load_plan(config) for config in configs]
    stop, snapshot = stop_and_snapshot()
    at = service_endpoints(plans[0].config.zenoh, plans[0].source)
    where, names = ", ".join([*at.listen, *at.connect]), ", ".join(repr(plan.config.id) for plan in plans)
    run(
        plans,
        stop=stop,
        started=lambda address: stderr.print(f"ready: filter {names} on {where}, health at {address}"),
        expose_http=expose_http,
        snapshot=snapshot,
    )
