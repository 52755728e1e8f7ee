"""From paths to an open log: files, folders of rosbag2, several of either."""

import os
from contextlib import ExitStack
from os import PathLike
from pathlib import Path

from fuselog.replay.bag_folder import read_folder
from fuselog.replay.decompress import Limits
from fuselog.replay.log import Log
from fuselog.replay.loss import Loss
from fuselog.replay.mcap_file import McapFile
from fuselog.replay.part import Part
from fuselog.replay.source import MappedFile


def open_log(
    path: str | PathLike[str], *more: str | PathLike[str], limits: Limits | None = None, check_crc: bool = True
) -> Log:
    """Open a log for reading; it is mapped, not loaded. Use it as a context manager.

    Several paths are one log, and so is a folder of rosbag2: the files that its ``metadata.yaml`` lists.

    Damage is no error: bad chunks are skipped, a cut file is read up to its cut, and `Log.losses` tells.
    Raises LogError when there is nothing to read: no such file, an empty one, or not a log.
    """
    names = [os.fspath(each) for each in (path, *more)]
    parts: list[Part] = []
    missing: list[Loss] = []
    with ExitStack() as opened:
        for name in names:
            files = [name]
            if _is_folder(name):
                folder = read_folder(Path(name))
                files = [str(file) for file in folder.files]
                missing += folder.missing
            for file in files:
                parts.append(_open_part(file, limits or Limits(), check_crc=check_crc))
                opened.callback(parts[-1].close)
        log = Log(", ".join(names), parts, missing)
        opened.pop_all()
    return log


def _is_folder(name: str) -> bool:
    try:
        return os.path.isdir(name)
    except ValueError:  # a NUL in the path
        return False


def _open_part(path: str, limits: Limits, *, check_crc: bool) -> Part:
    return McapFile(MappedFile(path), limits, check_crc=check_crc)
