"""``fuselog export``: topics of a log as Parquet, CSV, TUM or KITTI files."""

import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.console import print_json, stderr

if TYPE_CHECKING:
    from fuselog.replay import Log
    from fuselog.replay.export import Exported


class Format(StrEnum):
    """What can be written."""

    PARQUET = "parquet"
    CSV = "csv"
    TUM = "tum"
    KITTI = "kitti"


_SUFFIXES = {Format.TUM: ".tum", Format.KITTI: ".kitti", Format.PARQUET: ".parquet", Format.CSV: ".csv"}
_OWN_SUFFIXES = {*_SUFFIXES.values(), ".txt"}


def export(
    log: Annotated[Path, typer.Argument(help="The MCAP log.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="A folder for a file a topic; or, with a suffix, the file of one.")
    ],
    format: Annotated[Format, typer.Option("--format", "-f", help="Of the files.")] = Format.PARQUET,
    topics: Annotated[
        list[str] | None, typer.Option("--topics", "-t", help="Comma-separated, or repeated. [default: all]")
    ] = None,
    fields: Annotated[
        list[str] | None,
        typer.Option("--fields", help="Paths such as angular_velocity.z, comma-separated, or repeated. [default: all]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write topics as tables (Parquet, CSV) or trajectories (TUM, KITTI: topics with poses), a file each.

    Files appear whole or not at all. Exits 3 when messages or topics could not be written.
    """
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import

    wanted, paths = _split(topics), _split(fields)
    if paths and format in (Format.TUM, Format.KITTI):
        raise typer.BadParameter("trajectories have no fields to choose", param_hint="--fields")
    with open_log(log) as opened:
        chosen, left_out = _choose(opened, wanted, paths, format)
        files = _files(chosen, output, _SUFFIXES[format])
        exported = _write(opened, files, format, paths, force)
        losses = opened.losses
    for topic, reason in left_out.items():
        stderr.print(f"left out: {topic}: {reason}", markup=False)
    for loss in losses:
        stderr.print(f"lost: {log}: byte {loss.offset}: {loss.reason}", markup=False)
    if as_json:
        written = {t: {"path": str(e.path), "rows": e.rows, "bad": e.bad} for t, e in exported.items()}
        print_json({"schema": 1, "format": format.value, "files": written, "left_out": left_out})
    else:
        for topic, one in exported.items():
            bad = f", {one.bad} messages without a value" if one.bad else ""
            typer.echo(f"{topic}: {one.rows} rows{bad}: {one.path}")
    if losses or left_out or any(one.bad for one in exported.values()):
        raise typer.Exit(3)


def _split(values: list[str] | None) -> list[str]:
    return list(dict.fromkeys(part for value in values or [] for part in value.split(",") if part))


def _choose(log: "Log", wanted: list[str], fields: list[str], format: Format) -> tuple[list[str], dict[str, str]]:
    """The topics to write, and those that cannot be, with the reason; one that was asked for by name is an error."""
    from fuselog.replay.log.tables import TableDecoder  # noqa: PLC0415  slow to import
    from fuselog.replay.trajectory import is_pose  # noqa: PLC0415  slow to import
    from fuselog.schemas import LogError, SchemaError  # noqa: PLC0415  slow to import

    if format in (Format.TUM, Format.KITTI):
        found = wanted or [topic for topic in log.topics if is_pose(log[topic].type)]
        if not found:
            raise LogError(str(log.path), 0, "no topic with poses")
        return found, {}
    chosen: list[str] = []
    left_out: dict[str, str] = {}
    for topic in wanted or log.topics:
        try:
            TableDecoder(log[topic].channels, fields or None)
        except SchemaError as error:
            if wanted or fields:
                raise
            left_out[topic] = error.reason
        else:
            chosen.append(topic)
    return chosen, left_out


def _files(topics: list[str], output: Path, suffix: str) -> dict[str, Path]:
    """The path of each topic: ``output`` itself when it has the suffix of a file, else in that folder by its name."""
    if output.suffix in _OWN_SUFFIXES:
        if len(topics) != 1:
            raise typer.BadParameter(f"one file for {len(topics)} topics; name a folder", param_hint="--output")
        return {topics[0]: output}
    files: dict[str, Path] = {}
    taken: set[str] = set()
    for topic in topics:
        name = re.sub(r"[^\w-]+", "_", topic).strip("_") or "topic"
        count = sum(other == name or other.startswith(f"{name}.") for other in taken)
        unique = f"{name}.{count + 1}" if count else name
        taken.add(unique)
        files[topic] = output / f"{unique}{suffix}"
    return files


def _write(log: "Log", files: dict[str, Path], format: Format, fields: list[str], force: bool) -> "dict[str, Exported]":
    from fuselog.replay.export import FORMATS, export_tables  # noqa: PLC0415  slow to import
    from fuselog.replay.trajectory import read_trajectory, write_kitti, write_tum  # noqa: PLC0415  slow to import

    if format in (Format.PARQUET, Format.CSV):
        return export_tables(log, files, FORMATS[format.value], fields=fields or None, force=force)
    write = write_tum if format == Format.TUM else write_kitti
    return {topic: write(read_trajectory(log, topic), path, force=force) for topic, path in files.items()}
