"""One pass over a log that says all that is wrong with it."""

import os
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from fuselog.replay.doctor.finding import Finding
from fuselog.replay.doctor.topic import TopicHealth
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.recover.damage import Damage
from fuselog.replay.recover.salvage import Salvage
from fuselog.schemas.messages import Messages

_ORDER = {"error": 0, "warning": 1, "note": 2}
_SIGNS = (
    ("statistics", "statistics"),
    ("crc", "crc"),
    ("limit", "limit"),
    ("cut", "truncated"),
    ("footer", "truncated"),
)


@dataclass(frozen=True, slots=True)
class Examination:
    """The numbers of every channel, and the findings, the worst first."""

    path: str
    bytes: int
    messages: int
    topics: list[dict[str, Any]]
    findings: list[Finding]

    @property
    def sound(self) -> bool:
        """Whether no data are lost or damaged."""
        return all(finding.severity != "error" for finding in self.findings)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "schema": 1,
            "path": self.path,
            "bytes": self.bytes,
            "messages": self.messages,
            "sound": self.sound,
            "topics": self.topics,
            "findings": [finding.to_json() for finding in self.findings],
        }


def examine(path: str | PathLike[str], *, limits: Limits | None = None) -> Examination:
    """Read a log as `Salvage` does, once and in bounded memory; LogError when there is nothing to read."""
    salvage = Salvage(path, limits=limits)
    topics: dict[int, TopicHealth] = {}
    for item in salvage.items():
        if not isinstance(item, Messages):
            continue
        for id in np.unique(item.stream).tolist():
            if id not in topics:
                topics[id] = TopicHealth(salvage.channels()[id])
            topics[id].add(item.take(np.flatnonzero(item.stream == id)))
    for id, channel in salvage.channels().items():
        topics.setdefault(id, TopicHealth(channel))
    by_name = sorted(topics.values(), key=lambda topic: topic.channel.topic)
    findings = [_of_damage(damage) for damage in salvage.damages]
    findings += [finding for topic in by_name for finding in topic.findings()]
    findings.sort(key=lambda finding: _ORDER[finding.severity])
    return Examination(
        path=os.fspath(path),
        bytes=salvage.size,
        messages=sum(topic.count for topic in by_name),
        topics=[topic.to_json() for topic in by_name],
        findings=findings,
    )


def _of_damage(damage: Damage) -> Finding:
    code = next((code for sign, code in _SIGNS if sign in damage.reason), "damaged") if damage.lost else "mended"
    text = damage.reason if damage.end == 0 else f"{damage.reason}, up to byte {damage.end}"
    return Finding(code=code, text=text, count=damage.messages or 1, offset=damage.begin if damage.end else None)
