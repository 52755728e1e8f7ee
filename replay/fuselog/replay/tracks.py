"""Tracks in a log: what a filter publishes, written so that a later run knows it for an output."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Outputs, Plan
from fuselog.replay.log.channels import Channel
from fuselog.replay.mcap_file.writer import LogWriter
from fuselog.schemas import Messages

_MARK = {"fuselog": "output"}  # in the metadata of a channel
_OUTPUTS = {f"fuselog_msgs/msg/{name}" for name in ("Estimate", "Decision", "Health", "Command")}


def is_output(channel: Channel) -> bool:
    """Whether a channel holds results of a filter, which must not be fused again."""
    return channel.schema.name in _OUTPUTS or channel.metadata.get("fuselog") == "output"


def was_turned_away(channel: Channel) -> bool:
    """Whether a service recorded what it had no room for, and no filter got."""
    return channel.metadata.get("fuselog") == "turned_away"


class TrackWriter:
    """An output log; raises ``LogError`` when it cannot be written."""

    def __init__(self, path: str | Path, outputs: Outputs) -> None:
        self._writer = LogWriter(path, compression="lz4")
        self._channels = np.array(
            [
                self._writer.add_channel(o.topic, o.schema_name, "ros2msg", o.schema_text, metadata=_MARK)
                for o in outputs.topics
            ],
            np.int32,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def write(self, messages: Messages) -> None:
        """Append what ``Outputs.encode`` made."""
        self._writer.write(
            Messages(
                stream=self._channels[messages.stream],
                data=messages.data,
                start=messages.start,
                length=messages.length,
                log_time=messages.log_time,
                publish_time=messages.publish_time,
                sequence=messages.sequence,
            )
        )

    def describe(self, plan: Plan, made: Mapping[str, str], datum: NDArray[np.float64] | None) -> None:
        """Add how the track was made: version, ``made``, origin of geodetic coordinates, and configuration."""
        origin = "" if datum is None else " ".join(repr(float(number)) for number in datum)
        about = {"version": version("fuselog"), **made, "datum": origin, "config": plan.source.text}
        self._writer.add_metadata("fuselog", about)
