"""From paths to an open log: files, folders of rosbag2, several of either."""

import os
import re
from contextlib import ExitStack
from os import PathLike
from pathlib import Path

from fuselog.replay.bag_folder import read_folder
from fuselog.replay.log import Log
from fuselog.replay.log.loss import Loss
from fuselog.replay.log.part import Part
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.file import McapFile
from fuselog.replay.mcap_file.source import MappedFile, Source
from fuselog.schemas.errors import LogError

_URL = re.compile("(s3|gs|https?):/{1,2}(?=[^/])")  # pathlib makes one slash of two
_BAGS = (b"#ROSBAG V", b"SQLite format 3\0")  # the first bytes of what `rosbag` reads
_ZSTD = b"\x28\xb5\x2f\xfd"


def open_log(
    path: str | PathLike[str], *more: str | PathLike[str], limits: Limits | None = None, check_crc: bool = True
) -> Log:
    """Open a log for reading; it is mapped, not loaded. Use it as a context manager.

    ``s3://``, ``gs://`` and ``https://`` are read by ranges, with the extra ``remote``.

    Several paths are one log, and so is a folder of rosbag2: the files that its ``metadata.yaml`` lists. ROS 1 bags and
    ``.db3`` files need the extra ``ros``.

    Damage is no error: bad chunks are skipped, a cut file is read up to its cut, and `Log.losses` tells.
    Raises LogError when there is nothing to read: no such file, an empty one, or not a log.
    """
    names = [os.fspath(each) for each in (path, *more)]
    limits = limits or Limits()
    parts: list[Part] = []
    losses: list[Loss] = []
    with ExitStack() as opened:
        for name in names:
            if _is_folder(name):
                found, missed = _open_folder(Path(name), limits, check_crc=check_crc)
            else:
                found, missed = [_open_part(name, limits, check_crc=check_crc)], []
            for part in found:
                opened.callback(part.close)
            parts += found
            losses += missed
        log = Log(", ".join(names), parts, losses)
        opened.pop_all()
    return log


def _open_folder(folder: Path, limits: Limits, *, check_crc: bool) -> tuple[list[Part], list[Loss]]:
    """(the files of a recording, what is missing of it); raises LogError when none of its files can be read."""
    files, losses = read_folder(folder)
    parts: list[Part] = []
    for file in files:
        try:
            parts.append(_open_part(str(file), limits, check_crc=check_crc))
        except LogError as error:
            if file == files[-1] and not parts:
                raise
            losses.append(Loss(error.offset, error.reason, None, error.path))
    return parts, losses


def _is_folder(name: str) -> bool:
    try:
        return os.path.isdir(name)
    except ValueError:  # a NUL in the path
        return False


def _open_part(path: str, limits: Limits, *, check_crc: bool) -> Part:
    url = _URL.match(path)
    if url is not None:
        return McapFile(_open_remote(f"{url[1]}://{path[url.end() :]}"), limits, check_crc=check_crc)
    source = MappedFile(path)
    magic = source.read(0, 16).tobytes()
    if magic.startswith(_BAGS):
        source.close()
        return _open_bag(path)
    if magic.startswith(_ZSTD):
        raise LogError(path, 0, "compressed as a whole: unpack it first, with unzstd")
    return McapFile(source, limits, check_crc=check_crc)


def _open_remote(url: str) -> Source:
    try:
        from fuselog.replay.mcap_file.remote import RemoteFile  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise LogError(url, 0, "URLs are read by another package: pip install 'fuselog[remote]'") from error
    return RemoteFile(url)


def _open_bag(path: str) -> Part:
    try:
        from fuselog.replay.rosbag import RosbagFile  # noqa: PLC0415  an extra, and slow to import
    except ModuleNotFoundError as error:
        raise LogError(path, 0, "bags are read by another package: pip install 'fuselog[ros]'") from error
    return RosbagFile(path)
