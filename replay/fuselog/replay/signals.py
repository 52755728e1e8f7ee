"""Simulated sensors as messages: columns of numbers with stamps in, one log in the order of arrival out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file.writer import LogWriter
from fuselog.schemas import CdrEncoder, Messages, definition

_START_NS = 1_700_000_000_000_000_000  # stamps look like a clock's


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """n messages of one topic: ``values`` go to ``columns``, and each arrives ``latency_ns`` after its stamp."""

    topic: str
    schema_name: str
    t_ns: NDArray[np.int64]  # (n,) stamps
    columns: Sequence[str]
    values: NDArray[np.float64]  # (n, width)
    constants: dict[str, str | float] = field(default_factory=dict[str, str | float])
    lengths: dict[str, int] = field(default_factory=dict[str, int])  # of sequences in the message
    latency_ns: int = 0


def stamps(t: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """Stamps (n,) in ns of times (n,) in s from the start."""
    return _START_NS + np.rint(t * 1e9).astype(np.int64)


def reading(
    topic: str, t_ns: NDArray[np.int64], values: Mapping[str, NDArray[np.float64]], *, sd: Sequence[float] = ()
) -> Signal:
    """Named numbers (n,) as ``fuselog_msgs/msg/Reading``, ``values[0]`` the first; ``sd`` of each, if it is noisy."""
    names: dict[str, str | float] = {f"names[{i}]": name for i, name in enumerate(values)}
    variances: dict[str, str | float] = {f"variances[{i}]": one**2 for i, one in enumerate(sd)}
    return Signal(
        topic=topic,
        schema_name="fuselog_msgs/msg/Reading",
        t_ns=t_ns,
        columns=["values"],
        values=np.stack(list(values.values()), axis=1),
        constants=names | variances,
        lengths={"names": len(values), "values": len(values), "variances": len(sd)},
    )


def write_signals(path: str | PathLike[str], signals: Sequence[Signal]) -> int:
    """Write a log of all signals in the order of their arrival -> messages written. Raises ``LogError``."""
    with LogWriter(path) as writer:
        streams = [
            writer.add_channel(signal.topic, signal.schema_name, "ros2msg", definition(signal.schema_name))
            for signal in signals
        ]
        messages = encode(signals, streams)
        writer.write(messages)
    return len(messages)


def encode(signals: Sequence[Signal], streams: Sequence[int]) -> Messages:
    """All signals as messages in the order of their arrival, each with the number of its stream."""
    return _by_arrival([_messages(signal, stream) for signal, stream in zip(signals, streams, strict=True)])


def _messages(signal: Signal, stream: int) -> Messages:
    encoder = CdrEncoder(
        signal.schema_name,
        definition(signal.schema_name),
        columns=signal.columns,
        constants=signal.constants,
        lengths=signal.lengths,
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
