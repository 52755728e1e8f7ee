"""``fuselog check``: is a configuration right, and what would it do with a log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits


@with_limits
def check(
    config: Annotated[Path, typer.Argument(help="The fusion configuration (YAML).")],
    log: Annotated[Path | None, typer.Argument(help="A log to check it against.")] = None,
    explain: Annotated[bool, typer.Option("--explain", help="Print every setting, defaults included.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Validate a configuration; with a log, say which topic feeds what, without fusing anything."""
    from fuselog.fusion import Filter, load_plan  # noqa: PLC0415  slow to import
    from fuselog.fusion.kernel.tables import Role  # noqa: PLC0415  slow to import
    from fuselog.fusion.report import steady_gains  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.reprocess import open_inputs  # noqa: PLC0415  slow to import

    plan = load_plan(config)
    typer.echo(f"{config}: model {plan.card.name} ({', '.join(plan.states)})")
    for sensor in plan.sensors:
        verb = "corrects" if sensor.role == Role.MEASURES else "drives"
        gate = f", gate {sensor.settings.gate:g}" if sensor.settings.gate else ""
        typer.echo(f"  {sensor.settings.topic} -> {sensor.name} {verb} by {', '.join(sensor.names)}{gate}")
    for line in steady_gains(plan):
        typer.echo(f"  {line}")
    if explain:
        typer.echo(plan.config.model_dump_json(indent=2, by_alias=True))
    if log is not None:
        with open_log(log, limits=limits) as opened:
            used = open_inputs(opened, Filter(plan, order="by_stamp"))
            for topic in sorted(opened.topics):
                counts = [channel.count for channel in opened.topics[topic]]
                known = None if None in counts else sum(count or 0 for count in counts)
                state = "used" if topic in used else "not used"
                typer.echo(f"  {log.name}: {topic}: {'?' if known is None else known} messages, {state}")
    typer.echo("ok")
