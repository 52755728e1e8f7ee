"""Samples that get lost on the way come again, where their publisher keeps them; else they are counted exactly."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import zenoh

from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, read_tag, write_tag
from fuselog.service.zenoh_door import Publisher, subscribe, subscribe_reliably

from .test_transport_security import endpoint

SOURCE = b"sixteen bytes id"
ROUTER = """
import sys, time, zenoh
config = zenoh.Config.from_json5('{mode: "router", scouting: {multicast: {enabled: false}}}')
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
with zenoh.open(config):
    print("up", flush=True)
    time.sleep(600)
"""


class Router:
    """A router of its own process, which can be killed and started again."""

    def __init__(self) -> None:
        self.endpoint = endpoint("tcp")
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen([sys.executable, "-c", ROUTER, self.endpoint], stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"up\n"

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.communicate()


@pytest.fixture
def router() -> Iterator[Router]:
    router = Router()
    yield router
    router.kill()


@pytest.fixture
def sessions(router: Router) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """A session that publishes and one that subscribes, with only the router between them."""
    at = Endpoints(mode="client", connect=[router.endpoint])
    with open_session(at, timeout_s=10) as ours, open_session(at, timeout_s=10) as theirs:
        yield ours, theirs


def number(sample: zenoh.Sample) -> int:
    """What the publisher counted."""
    assert sample.attachment is not None
    assert sample.payload.to_bytes() == b"sample"
    return read_tag(sample.attachment.to_bytes()).sequence


def publish(publishers: list[Publisher], numbers: range, pause_s: float = 0.0) -> None:
    for sequence in numbers:
        for publisher in publishers:
            publisher.put(b"sample", write_tag(Tag(sequence, 1, SOURCE)))
        time.sleep(pause_s)


def wait(until: Callable[[], bool], seconds: float = 10.0) -> bool:
    """Whether it came true in time."""
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        time.sleep(0.01)
    return until()


def gaps(numbers: list[int]) -> int:
    """How many are missing before each other, which is what a filter counts."""
    return sum(after - before - 1 for before, after in zip([0, *numbers], numbers, strict=False))


def never(publisher: str, count: int) -> None:
    """Of ``missed``, where nothing may be."""
    raise AssertionError(f"{count} samples of {publisher} are gone")


def test_a_router_that_is_killed(router: Router, sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """Killed for a second while samples flow: a large cache gives all of them back in order, a small one what it
    has, none nothing; and what is missed is known to the last one.
    """
    theirs, ours = sessions
    got: dict[str, list[int]] = {"kept": [], "forgotten": [], "plain": []}
    missed: dict[str, list[int]] = {"kept": [], "forgotten": []}
    with ExitStack() as stack:
        for key in ("kept", "forgotten"):
            take = lambda sample, key=key: got[key].append(number(sample))  # noqa: E731  one line is clearer here
            lost = lambda _, count, key=key: missed[key].append(count)  # noqa: E731
            stack.callback(subscribe_reliably(ours, key, take, missed=lost))
        stack.callback(subscribe(ours, "plain", lambda sample: got["plain"].append(number(sample))))
        caches = {"kept": 10_000, "forgotten": 10, "plain": 0}
        publishers = [Publisher(theirs, key, "application/cdr", cache=cache) for key, cache in caches.items()]
        assert wait(lambda: publishers[2].wanted)
        publish(publishers, range(1, 301), 0.001)
        assert wait(lambda: all(len(numbers) == 300 for numbers in got.values()))
        router.kill()
        publish(publishers, range(301, 1001), 0.001)
        router.start()
        assert wait(lambda: publishers[2].wanted)
        sent = 1000
        while not (got["plain"][300:] and got["kept"][300:]) and sent < 5000:
            publish(publishers, range(sent + 1, sent + 101), 0.001)
            sent += 100
        publish(publishers, range(sent + 1, sent + 201), 0.001)
        sent += 200
        assert wait(lambda: all(numbers[-1] == sent for numbers in got.values()))
    assert got["kept"] == list(range(1, sent + 1))
    assert missed["kept"] == []
    for key in ("forgotten", "plain"):
        assert sorted(set(got[key])) == got[key]
        assert 0 < gaps(got[key]) == sent - len(got[key])
    assert sum(missed["forgotten"]) == gaps(got["forgotten"])


@pytest.fixture
def running(sessions: tuple[zenoh.Session, zenoh.Session]) -> Iterator[None]:
    """A publisher of ``imu`` that keeps its last 500 samples and sends a thousand a second."""
    publisher, stop = Publisher(sessions[0], "imu", "", cache=500), threading.Event()

    def run() -> None:
        sequence = 1
        while not stop.is_set():
            publish([publisher], range(sequence, sequence + 1), 0.001)
            sequence += 1

    thread = threading.Thread(target=run)
    thread.start()
    time.sleep(0.7)
    yield
    stop.set()
    thread.join()


@pytest.mark.usefixtures("running")
def test_joining_a_stream(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """The past is put before what is sent meanwhile, without a gap, every time."""
    for _ in range(10):
        got: list[int] = []
        before = time.monotonic()
        end = subscribe_reliably(sessions[1], "imu", lambda s, got=got: got.append(number(s)), missed=never)
        assert time.monotonic() - before < 3
        past = len(got)
        assert wait(lambda got=got, past=past: len(got) > past + 20)
        end()
        assert past >= 500
        assert gaps(got) == got[0] - 1
        assert sorted(set(got)) == got


def test_what_was_published_before(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """Who comes late gets what the cache holds, then what follows; a publisher that comes late gives its own too."""
    theirs, ours = sessions
    early = Publisher(theirs, "fleet/robot1/imu", "application/cdr", cache=50)
    publish([early], range(1, 81))
    got: dict[str, list[int]] = {"fleet/robot1/imu": [], "fleet/robot2/imu": []}
    end = subscribe_reliably(ours, "fleet/*/imu", lambda s: got[str(s.key_expr)].append(number(s)), missed=never)
    assert got["fleet/robot1/imu"] == list(range(31, 81))
    publish([early], range(81, 91))
    late = Publisher(theirs, "fleet/robot2/imu", "application/cdr", cache=50)
    publish([late], range(1, 11))
    assert wait(lambda: len(got["fleet/robot1/imu"]) >= 60 and len(got["fleet/robot2/imu"]) >= 10)
    end()
    assert got == {"fleet/robot1/imu": list(range(31, 91)), "fleet/robot2/imu": list(range(1, 11))}


def test_a_publisher_that_was_cut_off(router: Router, sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """It began while the router was down: what it kept comes first, while it goes on."""
    theirs, ours = sessions
    got: list[int] = []
    end = subscribe_reliably(ours, "imu", lambda sample: got.append(number(sample)), missed=never)
    router.kill()
    publisher = Publisher(theirs, "imu", "", cache=10_000)
    publish([publisher], range(1, 301), 0.001)
    assert got == []
    router.start()
    sent = 300
    while len(got) < 10 and sent < 5000:
        publish([publisher], range(sent + 1, sent + 101), 0.001)
        sent += 100
    assert wait(lambda: bool(got) and got[-1] == sent)
    end()
    assert got == list(range(1, sent + 1))


def test_nothing_comes_twice(router: Router, sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """A publisher that was there before us, and comes again with the router, does not give its past again."""
    theirs, ours = sessions
    publisher = Publisher(theirs, "imu", "", cache=10_000)
    time.sleep(0.2)  # until it is known
    got: list[int] = []
    end = subscribe_reliably(ours, "imu", lambda sample: got.append(number(sample)), missed=never)
    time.sleep(0.2)
    publish([publisher], range(1, 101))
    assert wait(lambda: len(got) == 100)
    router.kill()
    router.start()
    publish([publisher], range(101, 201))
    assert wait(lambda: len(got) >= 200)
    time.sleep(0.3)
    end()
    assert got == list(range(1, 201))


def test_everybody_hears_everybody(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """Plain subscribers get all of a publisher with a cache, reliable ones all of a plain publisher."""
    theirs, ours = sessions
    got: dict[str, list[int]] = {"plain": [], "reliable": []}
    subscribe(ours, "plain", lambda sample: got["plain"].append(number(sample)))
    end = subscribe_reliably(ours, "reliable", lambda s: got["reliable"].append(number(s)), missed=never)
    publishers = [Publisher(theirs, "plain", "", cache=10), Publisher(theirs, "reliable", "")]
    assert wait(lambda: publishers[1].wanted)
    time.sleep(0.2)  # until the other subscription is known too
    publish(publishers, range(1, 1001))
    assert wait(lambda: all(len(numbers) == 1000 for numbers in got.values()))
    end()
    assert got == {"plain": list(range(1, 1001)), "reliable": list(range(1, 1001))}


def test_a_session_that_is_closed_first(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """As an error on the way makes it happen: nothing hangs."""
    theirs, ours = sessions
    publisher = Publisher(theirs, "imu", "", cache=10)
    got: list[int] = []
    end = subscribe_reliably(ours, "imu", lambda sample: got.append(number(sample)), missed=never)
    publish([publisher], range(1, 11))
    assert wait(lambda: len(got) == 10)
    ours.close()
    end()
