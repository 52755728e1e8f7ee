"""How a log lies in its file: chunks and their compression, attachments, metadata, and whether it is whole."""

import os
from collections import Counter
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import mcap.records
import numpy as np
from mcap.data_stream import ReadDataStream
from numpy.typing import NDArray

from fuselog.replay.log.channels import parse
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import parse_header
from fuselog.replay.mcap_file.mapped import map_file
from fuselog.replay.mcap_file.records import FRAME
from fuselog.replay.recover.stretches import Stretch, stretches_of

_LARGEST = 1 << 20  # bytes of a header or metadata record; larger ones are not read for this
_MOST_NAMED = 1000  # attachments, and metadata records


@dataclass(slots=True)
class FileLayout:
    """Sizes in bytes; ``packed`` and ``unpacked`` of each chunk, as their headers say."""

    path: str
    size: int
    profile: str = ""
    library: str = ""
    compressions: Counter[str] = field(default_factory=Counter[str])  # chunks by compression
    packed: list[int] = field(default_factory=list[int])
    unpacked: list[int] = field(default_factory=list[int])
    attachments: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    metadata: list[str] = field(default_factory=list[str])
    truncated: bool = True

    def to_json(self) -> dict[str, Any]:
        """As plain data; ``chunk_bytes`` are the smallest, median and largest chunk, uncompressed."""
        sizes = np.array(self.unpacked or [0])
        return {
            "path": self.path,
            "bytes": self.size,
            "profile": self.profile,
            "library": self.library,
            "truncated": self.truncated,
            "chunks": len(self.unpacked),
            "compression": dict(self.compressions),
            "packed_bytes": sum(self.packed),
            "unpacked_bytes": sum(self.unpacked),
            "chunk_bytes": [int(sizes.min()), int(np.median(sizes)), int(sizes.max())] if self.unpacked else None,
            "attachments": self.attachments,
            "metadata": self.metadata,
        }


def describe(path: str | PathLike[str]) -> FileLayout:
    """Walk over the records of a file, opening none of its chunks; LogError when there is no file."""
    data = map_file(os.fspath(path))
    layout = FileLayout(os.fspath(path), len(data))
    for stretch in stretches_of(data):
        try:
            _take(layout, data, stretch)
        except ValueError:
            continue  # a broken record; who reads the log names it
    return layout


def _take(layout: FileLayout, data: NDArray[np.uint8], stretch: Stretch) -> None:
    match stretch.opcode:
        case records.CHUNK:
            header = parse_header(data, stretch.begin, stretch.end)
            layout.compressions[header.compression or "none"] += 1
            layout.packed.append(header.end - header.begin)
            layout.unpacked.append(header.size)
        case records.HEADER:
            header = parse(mcap.records.Header.read, _content(data, stretch))
            layout.profile, layout.library = header.profile, header.library
        case records.ATTACHMENT if len(layout.attachments) < _MOST_NAMED:
            head = data[stretch.begin + FRAME : min(stretch.begin + FRAME + _LARGEST, stretch.end)].tobytes()
            layout.attachments.append(parse(_read_attachment_head, head))
        case records.METADATA if len(layout.metadata) < _MOST_NAMED:
            layout.metadata.append(parse(mcap.records.Metadata.read, _content(data, stretch)).name)
        case records.FOOTER:
            layout.truncated = False
        case _:
            pass


def _read_attachment_head(stream: ReadDataStream) -> dict[str, Any]:
    log_time, create_time = stream.read8(), stream.read8()
    name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
    times = {"log_time": log_time, "create_time": create_time}
    return {"name": name, "media_type": media_type, "bytes": stream.read8()} | times


def _content(data: NDArray[np.uint8], stretch: Stretch) -> bytes:
    if stretch.end - stretch.begin > _LARGEST:
        raise ValueError("too large")
    return data[stretch.begin + FRAME : stretch.end].tobytes()
