"""Whatever is commanded: the exact order, nothing lost and nothing twice between two seeks, nothing early."""

from bisect import bisect_left
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from fuselog.replay.play import Playback, Range, Timeline

from .players import Listed, S, Time

times = st.lists(st.integers(0, 4 * S), min_size=1, max_size=40).map(sorted)
spans = st.tuples(st.integers(0, 4 * S), st.integers(1, 4 * S), st.booleans(), st.booleans())
commands = st.lists(
    st.one_of(
        st.tuples(st.just("wait"), st.integers(0, 2 * S)),
        st.tuples(st.just("pause"), st.none()),
        st.tuples(st.just("resume"), st.none()),
        st.tuples(st.just("rate"), st.sampled_from([None, 0.001, 0.3, 1.0, 7.0, 1e6])),
        st.tuples(st.just("seek"), st.integers(-S, 5 * S)),
        st.tuples(st.just("step"), st.integers(1, 5)),
    ),
    max_size=30,
)


class Followed:
    """A playback, and beside it the number of the message that must leave next."""

    def __init__(self, times: list[int], span: tuple[int, int, bool, bool]) -> None:
        start, length, bounded, loops = span
        start = times[0] + start % (times[-1] - times[0] + 1)
        end = start + length if bounded else None
        again = start if loops and (times[-1] if end is None else end) > start else None
        self.times, self.time = times, Time()
        self.range = Range(first=times[0], last=times[-1], start=start, end=end, again=again)
        self.source = Listed(times)
        self.play = Playback(self.source, Timeline(self.range, self.time.clock))
        self.next = bisect_left(times, start)
        self.end = len(times) if end is None else bisect_left(times, end)
        self.left = 0

    def drain(self, most: int = 200) -> None:
        """Take what is due now; some loops have no end."""
        for _ in range(most):
            if self.play.over:
                return
            before = self.play.timeline.position
            due = self.play.due()
            if due is None or due > self.time.now:
                return
            steps = self.play.timeline.paused
            played = self.play.take()
            if played is None:
                assert self.range.again is not None
                assert self.next >= self.end
                self.next = bisect_left(self.times, self.range.again)
                continue
            assert played == self.source.messages[self.next]
            assert self.next < self.end
            assert self.play.timeline.position >= before
            self.next += 1
            self.left += 1
            self.steps -= steps
            assert self.steps >= 0

    steps = 0

    def do(self, command: str, value: float | None) -> None:
        """Follow a command."""
        line = self.play.timeline
        match command:
            case "wait":
                self.time.now += int(value or 0)
            case "pause":
                line.pause()
                self.steps = 0
            case "resume":
                line.resume()
            case "rate":
                line.set_rate(value)
            case "seek":
                self.play.seek(int(value or 0))
                self.steps = 0
                self.next = bisect_left(self.times, line.position)
            case _:
                self.steps = (self.steps if line.paused else 0) + int(value or 0)
                line.step(int(value or 0))


@given(times, spans, commands)
def test_any_commands(times: list[int], span: tuple[int, int, bool, bool], commands: list[tuple[str, float]]) -> None:
    """Each message that leaves is the one after the last, and in the end all have left that should."""
    followed = Followed(times, span)
    followed.drain()
    for command, value in commands:
        if not followed.play.over:
            followed.do(command, value)
            followed.drain()
    play = followed.play
    if followed.range.again is None and not play.over:
        play.timeline.resume()
        play.timeline.set_rate(1.0)
        while not play.over:
            followed.time.now += S
            followed.drain()
        assert followed.next >= followed.end


@given(times, st.lists(st.integers(0, S), min_size=60, max_size=60), st.sampled_from([0.3, 1.0, 7.0]))
def test_a_consumer_of_any_slowness(times: list[int], waits: list[int], rate: float) -> None:
    """Nothing leaves early or is dropped, and between two messages there is never less time than 50 ms below theirs."""
    time, source = Time(), Listed(times)
    span = Range(first=times[0], last=times[-1], start=times[0])
    play = Playback(source, Timeline(span, time.clock, rate=rate))
    left: list[tuple[int, int]] = []
    for wait in waits:
        if play.over:
            break
        due = play.due()
        assert due is not None
        time.now = max(time.now, due)
        played = play.take()
        assert played is not None
        left.append((time.now, played.t_ns))
        time.now += wait
    assert [t for _, t in left] == times
    for (then, a), (now, b) in pairwise(left):
        assert now - then >= (b - a) / rate - 50_000_000 - 1
    lateness = left[-1][0] - left[0][0] - (times[-1] - times[0]) / rate
    assert -1 <= lateness - play.timeline.slipped_ns <= 50_000_001


@given(times, st.integers(1, 4 * S), st.sampled_from([0.3, 1.0, 7.0]))
def test_loops_are_exact(times: list[int], length: int, rate: float) -> None:
    """Every round plays the same messages, one length after the round before."""
    time, source = Time(), Listed(times)
    a, b = times[0], times[0] + length
    play = Playback(source, Timeline(Range(first=a, last=times[-1], start=a, end=b, again=a), time.clock, rate=rate))
    rounds: list[list[tuple[int, bytes]]] = [[]]
    while len(rounds) < 5:
        time.now = max(time.now, play.due() or 0)
        played = play.take()
        if played is None:
            rounds.append([])
        else:
            rounds[-1].append((time.now, played.payload))
    expected = [m.payload for m in source.messages if m.t_ns < b]
    for number, one in enumerate(rounds[:4]):
        assert [payload for _, payload in one] == expected
        for (when, _), (first, _) in zip(one, rounds[0], strict=True):
            assert abs(when - first - number * length / rate) <= number + 1
