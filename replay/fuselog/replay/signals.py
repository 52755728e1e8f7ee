"""Simulated sensors as messages: columns of numbers with stamps in, one log in the order of arrival out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.writer import LogWriter
from fuselog.schemas import CdrEncoder, Messages, definition


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """n messages of one topic: ``values`` go to ``columns``, and each arrives ``latency_ns`` after its stamp."""

    topic: str
    schema_name: str
    t_ns: NDArray[np.int64]  # (n,) stamps
    columns: Sequence[str]
    values: NDArray[np.float64]  # (n, width)
    constants: dict[str, str | float] = field(default_factory=dict[str, str | float])
    latency_ns: int = 0


def write_signals(path: str | PathLike[str], signals: Sequence[Signal]) -> int:
    """Write a log of all signals in the order of their arrival -> messages written. Raises ``LogError``."""
    with LogWriter(path) as writer:
        streams = [
            writer.add_channel(signal.topic, signal.schema_name, "ros2msg", definition(signal.schema_name))
            for signal in signals
        ]
        messages = _by_arrival([_messages(signal, stream) for signal, stream in zip(signals, streams, strict=True)])
        writer.write(messages)
    return len(messages)


def _messages(signal: Signal, stream: int) -> Messages:
    encoder = CdrEncoder(
        signal.schema_name,
        definition(signal.schema_name),
        columns=signal.columns,
        constants=signal.constants,
    )
    data, size = encoder.encode(signal.t_ns, signal.values)
    n = len(signal.t_ns)
    return Messages(
        stream=np.full(n, stream, np.int32),
        data=data,
        start=np.arange(n) * size,
        length=np.full(n, size),
        log_time=signal.t_ns + signal.latency_ns,
        publish_time=signal.t_ns,
        sequence=np.arange(n),
    )


def _by_arrival(parts: Sequence[Messages]) -> Messages:
    """All messages by log time, ties in the order of the parts; payloads stay where they are."""
    begins = np.cumsum([0, *(len(part.data) for part in parts)])
    log_time = np.concatenate([part.log_time for part in parts])
    order = np.argsort(log_time, kind="stable")
    return Messages(
        stream=np.concatenate([part.stream for part in parts])[order],
        data=np.concatenate([part.data for part in parts]),
        start=np.concatenate([part.start + begin for part, begin in zip(parts, begins[:-1], strict=True)])[order],
        length=np.concatenate([part.length for part in parts])[order],
        log_time=log_time[order],
        publish_time=np.concatenate([part.publish_time for part in parts])[order],
        sequence=np.concatenate([part.sequence for part in parts])[order],
    )
