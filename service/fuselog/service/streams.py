"""What the streams on Zenoh are: publishers tell who asks, and a filter learns the type of what it gets."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import NamedTuple

import orjson
import zenoh

from fuselog.fusion import Stream
from fuselog.fusion.intake import TF_STATIC, Intake, same_topic
from fuselog.schemas import FuselogError, SchemaError, definition, rihs01
from fuselog.service.wire import message_type
from fuselog.service.zenoh_door import alive, answer, ask

_ABOUT = "@fuselog/stream"  # `**` does not match what begins with @, so no one gets this by accident
_LARGEST = 4 << 20  # bytes of a description that is read
_PATIENCE_S = 1.0
_MOST_HEARD = 1000  # keys, the oldest are forgotten
_SLASH = "\u00a7"  # of names in liveliness tokens of bridges

Learn = Callable[[str], list[Stream]]


class Announced(NamedTuple):
    """A stream as its publisher describes it, and whether it holds results of a filter."""

    stream: Stream
    is_output: bool


class Announcements:
    """Answers everyone who asks what is published under the keys that were added, as long as the session lives.

    ``outputs``: they hold results of a filter.
    """

    def __init__(self, session: zenoh.Session, *, outputs: bool = False) -> None:
        self._outputs = outputs
        self._texts: dict[str, bytes] = {}
        answer(session, f"{_ABOUT}/**", self._about)

    def add(self, streams: Mapping[str, Iterable[Stream]]) -> None:
        """Tell of the streams of these keys from now on."""
        texts = {
            f"{_ABOUT}/{key}": orjson.dumps([asdict(s) | {"output": self._outputs} for s in several])
            for key, several in streams.items()
        }
        self._texts = self._texts | texts  # replaced, for queries are answered on another thread

    def forget(self, keys: Iterable[str]) -> None:
        """Tell of them no more."""
        gone = {f"{_ABOUT}/{key}" for key in keys}
        self._texts = {key: text for key, text in self._texts.items() if key not in gone}

    def _about(self, query: zenoh.Query) -> dict[str, bytes]:
        return {key: text for key, text in self._texts.items() if query.key_expr.intersects(key)}


def tell(session: zenoh.Session, streams: Mapping[str, Iterable[Stream]], *, outputs: bool = False) -> None:
    """Tell of these streams."""
    Announcements(session, outputs=outputs).add(streams)


class Hearsay:
    """What publishers say of their streams, for several threads; what was heard last is remembered.

    A recording may come to ask when a filter has taken everything and the publisher has gone.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self._heard: OrderedDict[str, list[Announced]] = OrderedDict()
        self._lock = threading.Lock()

    def learn(self, key: str) -> list[Stream]:
        """What publishers say of ``key`` now; empty when nobody does."""
        return [each.stream for each in self._ask(key)]

    def announced(self, key: str) -> list[Announced]:
        """The same, with which of them are outputs; what was said last when nobody says anything now."""
        told = self._ask(key)
        with self._lock:
            return told or self._heard.get(key, [])

    def _ask(self, key: str) -> list[Announced]:
        texts = ask(self.session, f"{_ABOUT}/{key}", timeout_s=_PATIENCE_S)
        told = [each for text in texts for each in _described(text)]
        if told:
            with self._lock:
                self._heard[key] = told
                if len(self._heard) > _MOST_HEARD:
                    self._heard.popitem(last=False)
        return told


def _described(text: bytes) -> list[Announced]:
    """The streams of an answer; none when it is not one."""
    if len(text) > _LARGEST:
        return []
    try:
        return [
            Announced(Stream(**{name: str(each[name]) for name in Stream.__slots__}), each.get("output") is True)
            for each in orjson.loads(text)
        ]
    except (ValueError, TypeError, KeyError):
        return []


def bridged_type(session: zenoh.Session, key: str) -> str:
    """The type that a bridge of ROS 2 (zenoh-bridge-ros2dds) announces for a key; empty when none does."""
    tokens = alive(session, f"@/*/@ros2_lv/MP/{key.replace('/', _SLASH)}/*/*", timeout_s=_PATIENCE_S)
    return tokens[0].split("/")[5].replace(_SLASH, "/") if tokens else ""


class Streams:
    """Numbers the streams of the keys of a filter, and opens each in its intake when its first sample comes.

    What the publisher says of its type counts first, for logs hold types that differ from today's of the same name;
    then the definitions that come with fuselog. ``identify`` gives the number, or why there is none.
    """

    def __init__(self, intake: Intake, types: Mapping[str, str], learn: Learn) -> None:
        self._intake = intake
        self._types = types  # by key: what the configuration says
        self._learn = learn
        self._numbers: dict[Stream, int] = {}

    def identify(self, key: str, media: str) -> int | str:
        """The number of the stream that carries samples of ``key`` with this encoding of Zenoh's."""
        encoding, said = message_type(media)
        name, _, hashed = said.partition(";")
        told = [s for s in self._learn(key) if encoding in ("", s.encoding) and name in ("", s.schema_name)]
        try:
            stream = told[0] if told else _known(key, encoding or "cdr", name or self._types.get(key, ""), hashed)
            if stream not in self._numbers:
                number = max(self._numbers.values(), default=-1) + 1
                self._intake.open(number, stream)
                self._numbers[stream] = number
        except FuselogError as error:
            return str(error)
        return self._numbers[stream]

    def resume(self, streams: Mapping[int, Stream]) -> None:
        """Know the streams that the intake has open already."""
        self._numbers = {stream: number for number, stream in streams.items()}


def _known(key: str, encoding: str, name: str, hashed: str) -> Stream:
    if not name:
        raise SchemaError(key, "the publisher does not say its type; name it in the configuration (type)")
    if encoding != "cdr":
        raise SchemaError(name, f"the publisher does not give the definition that {encoding} needs")
    text = definition(name)
    if hashed.startswith("RIHS01_") and hashed != rihs01(name, text):
        raise SchemaError(name, f"the publisher has another definition: its hash is {hashed}")
    return Stream(topic=key, encoding="cdr", schema_name=name, schema_encoding="ros2msg", schema_text=text)


def stream_types(topics: Mapping[str, str | None]) -> dict[str, str]:
    """By key: the type that the configuration gives for a topic, and that of the static transforms."""
    given = {same_topic(topic): kind for topic, kind in topics.items() if kind is not None}
    return {same_topic(TF_STATIC): "tf2_msgs/msg/TFMessage"} | given
