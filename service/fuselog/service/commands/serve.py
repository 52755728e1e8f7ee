"""``fuselog serve``: filters on live data."""

from pathlib import Path
from typing import Annotated

import typer

from fuselog.service.console import stderr
from fuselog.service.signals import reload_asked, stop_and_snapshot


def serve(
    configs: Annotated[list[Path], typer.Argument(help="Fusion configurations (YAML), each of one filter or more.")],
    behind_proxy: Annotated[
        bool,
        typer.Option("--behind-proxy", help="HTTP comes from a proxy that has TLS; whoever asks needs a token."),
    ] = False,
    expose_http: Annotated[bool, typer.Option("--expose-http", hidden=True)] = False,
) -> None:
    """Fuse what comes on Zenoh, publish the estimates, and answer for health over HTTP.

    SIGTERM or Ctrl-C ends it after what has come is fused and published; Ctrl-C again ends it at once.
    SIGUSR1 writes a snapshot, where the configuration keeps one (record: snapshot). SIGHUP reads the configurations
    again, and filters go on with what they say now.
    """
    if expose_http:
        raise typer.BadParameter(
            "is no more: set http.tokens and http.tls, or --behind-proxy", param_hint="--expose-http"
        )
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.service.live.serving import serve as run  # noqa: PLC0415  slow to import
    from fuselog.service.rest.audit import audit_to_stderr  # noqa: PLC0415  slow to import
    from fuselog.service.transport import service_endpoints  # noqa: PLC0415  slow to import

    plans = [load_plan(config) for config in configs]
    audit_to_stderr()
    stop, snapshot = stop_and_snapshot()
    at = service_endpoints(plans[0].config.zenoh, plans[0].source)
    where, names = ", ".join([*at.listen, *at.connect]), ", ".join(repr(plan.config.id) for plan in plans)
    run(
        plans,
        stop=stop,
        started=lambda address: stderr.print(f"ready: filter {names} on {where}, health at {address}"),
        behind_proxy=behind_proxy,
        snapshot=snapshot,
        reload=reload_asked(),
        say=stderr.print,
    )
