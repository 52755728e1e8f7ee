"""Live and offline compared: a log through a service over Zenoh, and through the same filter without it."""

import hashlib
import socket
import tempfile
import time
from array import array
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np
import zenoh

from fuselog.fusion import Filter, Output, Outputs, Plan, Stream
from fuselog.fusion.outputs import ESTIMATE
from fuselog.fusion.report import estimate_json, ledger_json
from fuselog.replay import Log
from fuselog.replay.play import playable, source_of
from fuselog.replay.reprocess import run as fused
from fuselog.replay.tracks import was_turned_away
from fuselog.schemas import Messages
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.group import make_group
from fuselog.service.play.playing import Commands, Pace, range_of
from fuselog.service.play.playing import run as play
from fuselog.service.transport import Endpoints, key_of, open_session
from fuselog.service.zenoh_door import subscribe

_CONNECT_S, _WAIT_S = 10.0, 30.0
_SILENCE_S = 5.0  # without another result, when some are missing

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Difference:
    """The first message of a topic that is not the same, and its states live and offline, None where it has none."""

    topic: str
    message: int  # from 0
    t_ns: int | None
    live: dict[str, float] | None
    offline: dict[str, float] | None


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was compared; hashes are over all messages of a topic, one after another."""

    messages: int
    topics: dict[str, dict[str, Any]]
    ledger: dict[str, dict[str, Any]]
    final: dict[str, Any]
    differences: list[Difference]

    @property
    def equal(self) -> bool:
        """Whether live and offline are the same bytes, with the same ledger and final state."""
        return not self.differences

    def to_json(self) -> dict[str, Any]:
        """The verdict as plain data."""
        return {"schema": 1, "equal": self.equal, **asdict(self)}


def verify(log: Log, plan: Plan, *, say: Progress = lambda _: None) -> Verdict:
    """Fuse a log offline, in the order received, then play it into a service over TCP as fast as that takes it.

    Nothing is recorded, and results are published as CDR, whatever the configuration says. Raises ``LogError``,
    ``ConfigError`` and ``TransportError``.
    """
    as_cdr = plan.config.output.model_copy(update={"encoding": "cdr"})
    plan = replace(plan, config=plan.config.model_copy(update={"record": None, "output": as_cdr}))
    outputs = Outputs(plan)
    with ExitStack() as stack:
        offline, live = ([stack.enter_context(_Kept(output)) for output in outputs.topics] for _ in range(2))
        say("fusing it offline")
        filter = Filter(plan, order="as_received")
        count = 0
        for fed, track in fused(log, filter):
            count += fed
            _keep(offline, outputs.encode(track, filter.beside()))
        _keep(offline, outputs.finish())
        say("playing it into a service")
        ledger, final = _live(log, plan, offline, live)
        differences = [d for pair in zip(live, offline, strict=True) if (d := _compare(*pair)) is not None]
        same = (ledger, final) == (ledger_json(filter.ledger), estimate_json(plan, filter.estimate))
        if not same and not differences:
            differences.append(Difference("the ledger or the final state", 0, None, None, None))
        topics = {kept.output.topic: {"messages": len(kept), "sha256": kept.sha256} for kept in live}
        return Verdict(count, topics, ledger, final, differences)


def _live(log: Log, plan: Plan, expected: list["_Kept"], kept: list["_Kept"]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Play a log into a service in this process and keep what it publishes -> its ledger and final state."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with (
        open_session(Endpoints(listen=[endpoint]), timeout_s=_CONNECT_S) as session,
        open_session(Endpoints(connect=[endpoint]), timeout_s=_CONNECT_S) as listener,
    ):
        for each in kept:
            subscribe(listener, key_of(each.output.topic), partial(_take, each))
        fleet = Fleet([make_group(plan)], session, ended=lambda: None)
        time.sleep(0.5)  # until the service knows who listens
        channels = [channel for channel in playable(log) if not was_turned_away(channel)]
        source = source_of(log, channels, "log")
        names = {channel.topic: channel.topic for channel in channels}
        pace = Pace(rate=None, paused=False, delay_s=0.0, clock_hz=None)
        play(
            *(source, channels, names),
            span=range_of(source, start="0"),
            pace=pace,
            commands=Commands(name=None, keys=False),
            at=Endpoints(connect=[endpoint]),
            wait_s=_WAIT_S,
        )
        fleet.finish()
        _wait(kept, expected)
        snapshot = fleet.ended()[plan.config.id]
        return ledger_json(snapshot.ledger), estimate_json(plan, snapshot.estimate)


class _Kept:
    """The messages of one topic, in a file."""

    def __init__(self, output: Output) -> None:
        self.output = output
        self.last = time.monotonic()  # when the newest came
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  closed with this object
        self._sizes = array("q")
        self._hash = hashlib.sha256()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return len(self._sizes)

    @property
    def sha256(self) -> str:
        """Over all messages."""
        return self._hash.hexdigest()

    @property
    def sizes(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Of the messages (n,)."""
        return np.array(self._sizes, np.int64)

    def add(self, payload: bytes) -> None:
        """The next message."""
        self._file.write(payload)
        self._sizes.append(len(payload))
        self._hash.update(payload)
        self.last = time.monotonic()

    def message(self, number: int) -> bytes | None:
        """One of them, None when there are not so many."""
        if number >= len(self):
            return None
        sizes = self.sizes
        self._file.flush()
        self._file.seek(int(sizes[:number].sum()))
        return self._file.read(int(sizes[number]))


def _keep(kept: list[_Kept], messages: Messages) -> None:
    data = messages.data.data
    for stream, start, length in zip(messages.stream, messages.start, messages.length, strict=True):
        kept[int(stream)].add(bytes(data[start : start + length]))


def _take(kept: _Kept, sample: zenoh.Sample) -> None:
    kept.add(sample.payload.to_bytes())


def _wait(kept: list[_Kept], expected: list[_Kept]) -> None:
    """Until as many messages have come as are to be expected, or none comes any more."""
    while any(len(have) < len(want) for have, want in zip(kept, expected, strict=True)):
        if time.monotonic() - max(each.last for each in kept) > _SILENCE_S:
            return
        time.sleep(0.01)


def _compare(live: _Kept, offline: _Kept) -> Difference | None:
    """The first message that differs."""
    if live.sha256 == offline.sha256 and len(live) == len(offline):
        return None
    number = next(n for n in range(max(len(live), len(offline))) if live.message(n) != offline.message(n))
    one, other = live.message(number), offline.message(number)
    (t_ns, mine), (theirs_ns, theirs) = _numbers(live.output, one), _numbers(offline.output, other)
    return Difference(live.output.topic, number, t_ns if t_ns is not None else theirs_ns, mine, theirs)


def _numbers(output: Output, payload: bytes | None) -> tuple[int | None, dict[str, float] | None]:
    """Stamp and numbers of a message: for an estimate its states by name."""
    if payload is None:
        return None, None
    stream = Stream(
        topic=output.topic,
        encoding="cdr",
        schema_name=output.schema_name,
        schema_encoding="ros2msg",
        schema_text=output.schema_text,
    )
    data, start, length = np.frombuffer(payload, np.uint8), np.zeros(1, np.int64), np.full(1, len(payload))
    if output.schema_name != ESTIMATE:
        return int(stream.codec([], "header.stamp").decode(data, start, length).t_ns[0]), None
    count = int(stream.codec(["names[]"]).decode(data, start, length).values[0, 0])
    fields = [f"state[{i}]" for i in range(count)] + [f"names[{i}]" for i in range(count)]
    columns = stream.codec(fields, "header.stamp").decode(data, start, length)
    names = [columns.texts[f"names[{i}]"][0] for i in range(count)]
    return int(columns.t_ns[0]), {name: float(columns[f"state[{i}]"][0]) for i, name in enumerate(names)}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
