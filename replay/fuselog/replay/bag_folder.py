"""Folders of rosbag2: the files of one recording, as its metadata.yaml lists them."""

import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, cast

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from fuselog.replay.log.loss import Loss
from fuselog.schemas.errors import LogError

_METADATA = "metadata.yaml"
_LARGEST = 8 << 20  # bytes of metadata.yaml


class BagFolder(NamedTuple):
    """The files of a recording in order, and those of them that are not there."""

    files: list[Path]
    missing: list[Loss]


def read_folder(folder: Path) -> BagFolder:
    """What a folder holds. Raises LogError when that is no recording.

    Files are sought by name in the folder itself, since old recorders wrote the path from elsewhere. Without
    ``metadata.yaml``, as a recorder that was killed leaves it, all ``.mcap`` files, numbers in names by their value.
    """
    about = folder / _METADATA
    if not about.is_file():
        files = sorted(folder.glob("*.mcap"), key=_natural)
        if not files:
            raise LogError(str(folder), 0, f"a folder without {_METADATA} and without .mcap files")
        return BagFolder(files, [])
    told = _load(about)
    if str(told.get("compression_mode") or "none").lower() == "message":
        raise LogError(str(about), 0, "its messages are compressed one by one: convert it with ros2 bag convert")
    listed = [folder / PurePosixPath(name.replace("\\", "/")).name for name in _names(told, about)]
    files = [file for file in dict.fromkeys(listed) if file.is_file()]
    missing = [
        Loss(0, f"{_METADATA} lists this file, and it is not there", None, str(file))
        for file in listed
        if not file.is_file()
    ]
    if not files:
        raise LogError(str(about), 0, "none of the files that it lists is there")
    return BagFolder(files, missing)


def _load(about: Path) -> dict[str, Any]:
    try:
        if about.stat().st_size > _LARGEST:
            raise LogError(str(about), 0, f"larger than {_LARGEST} bytes")
        yaml = YAML(typ="safe", pure=True)
        document: object = yaml.load(about)  # pyright: ignore[reportUnknownMemberType]  it takes any stream
    except (OSError, YAMLError, ValueError) as error:
        raise LogError(str(about), 0, f"cannot be read: {error}".splitlines()[0]) from error
    information = cast(dict[str, Any], document).get("rosbag2_bagfile_information") if _is_map(document) else None
    if not _is_map(information):
        raise LogError(str(about), 0, "no rosbag2_bagfile_information in it")
    return cast(dict[str, Any], information)


def _names(told: dict[str, Any], about: Path) -> Sequence[str]:
    names: object = told.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in cast(list[object], names)):
        raise LogError(str(about), 0, "relative_file_paths is no list of names")
    return cast(list[str], names)


def _is_map(value: object) -> bool:
    return isinstance(value, dict)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sorts ``part_2`` before ``part_10``."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name)]
