"""When each message leaves, by a clock that the test moves: rates, pauses, jumps, loops, and slow consumers."""

from collections.abc import Generator
from itertools import pairwise

import pytest

from fuselog.replay.play import CommandError, Playback, Played, Range, Timeline

from .players import Listed, S, Time, taken


def playback(
    time: Time, source: Listed, *, end: float | None = None, again: float | None = None, **options
) -> Playback:
    """A playback from the first message on; s."""
    start = options.pop("start", 0.0)
    span = Range(
        first=source.first,
        last=source.last,
        start=source.first + round(start * S),
        end=None if end is None else source.first + round(end * S),
        again=None if again is None else source.first + round(again * S),
    )
    clock_hz = options.pop("clock_hz", None)
    return Playback(source, Timeline(span, time.clock, **options), clock_hz=clock_hz)


def seconds(count: int) -> Listed:
    """A message a second, from 1000 s on."""
    return Listed([(1000 + i) * S for i in range(count)])


def test_rate() -> None:
    """At rate 2 a second of the log takes half a second; without pacing none takes any time."""
    time = Time()
    assert taken(playback(time, seconds(4), rate=2.0), time) == [(0, "0"), (0.5, "1"), (1, "2"), (1.5, "3")]
    time = Time()
    assert taken(playback(time, seconds(3), rate=None), time) == [(0, "0"), (0, "1"), (0, "2")]


def test_delay_start_and_end() -> None:
    """The delay comes before the first message; the end does not play and is not waited for."""
    time = Time()
    part = playback(time, seconds(9), start=1.5, end=4.0, delay_ns=3 * S)
    assert part.status().offset_s == 1.5
    assert taken(part, time) == [(3.5, "2"), (4.5, "3")]
    assert part.over
    assert part.status().state == "ended"


def test_rate_changes_on_the_way() -> None:
    """What is left of a gap takes its share of the new rate."""
    time = Time()
    play = playback(time, seconds(4))
    assert taken(play, time, until=1) == [(0, "0"), (1, "1")]
    time.now += S // 2
    play.timeline.set_rate(0.5)
    assert play.status().offset_s == 1.5
    assert taken(play, time) == [(2.5, "2"), (4.5, "3")]


def test_pause_and_resume() -> None:
    """The position stands still; nothing is late afterwards."""
    time = Time()
    play = playback(time, seconds(3))
    taken(play, time, until=0)
    time.now += S // 4
    play.timeline.pause()
    time.now += 50 * S
    assert play.due() is None
    assert play.status().offset_s == 0.25
    assert play.status().state == "paused"
    play.timeline.resume()
    play.timeline.resume()
    assert taken(play, time) == [(51, "1"), (52, "2")]
    assert play.status().slipped_s == 0


def test_steps() -> None:
    """A step pauses and lets one message leave at once; resuming goes on from it."""
    time = Time()
    play = playback(time, seconds(9), paused=True)
    assert taken(play, time) == []
    play.timeline.step()
    assert taken(play, time) == [(0, "0")]
    play.timeline.step(2)
    play.timeline.step()
    assert taken(play, time, until=5) == [(0, "1"), (0, "2"), (0, "3")]
    assert play.status().offset_s == 3
    play.timeline.resume()
    play.timeline.resume()
    assert taken(play, time, until=6) == [(6, "4")]
    play.timeline.step()
    assert taken(play, time) == [(6, "5")]
    with pytest.raises(CommandError, match="0 messages"):
        play.timeline.step(0)


def test_seek_both_ways() -> None:
    """Where it goes is due at once; a jump beyond either end goes to that end."""
    time = Time()
    play = playback(time, seconds(9))
    taken(play, time, until=2)
    play.seek(1006 * S + S // 2)
    assert taken(play, time, until=3) == [(2.5, "7")]
    play.seek(0)
    assert play.status().offset_s == 0
    assert taken(play, time, until=4) == [(3, "0"), (4, "1")]
    play.timeline.pause()
    play.seek(1005 * S)
    assert taken(play, time) == []
    play.timeline.step()
    assert taken(play, time) == [(4, "5")]
    play.seek(2000 * S)
    play.timeline.resume()
    assert taken(play, time) == [(4, "8")]
    assert play.over


def test_paused_at_the_end_one_can_seek_back() -> None:
    """Only playing on, or stopping, ends it."""
    time = Time()
    play = playback(time, seconds(3))
    play.timeline.step(7)
    assert len(taken(play, time)) == 3
    assert not play.over
    assert play.due() is None
    play.seek(1001 * S)
    play.timeline.resume()
    assert taken(play, time) == [(0, "1"), (1, "2")]
    assert play.over


def test_a_slow_consumer_shifts_the_timeline() -> None:
    """Late by 5 s: the messages after it keep their distances, none is left out, and the shift is told."""
    time = Time()
    play = playback(time, Listed([i * S // 2 for i in range(6)]))
    assert play.due() == time.now
    assert play.take() is not None
    time.now += 5 * S
    assert play.status().offset_s == 0  # it waits for what has just left
    assert taken(play, time) == [(5, "1"), (5.5, "2"), (6, "3"), (6.5, "4"), (7, "5")]
    assert play.status().slipped_s == 4.5


def test_a_little_lateness_is_caught_up() -> None:
    """Up to 50 ms: the clock of the log does not drift by what each sleep is late."""
    time = Time()
    play = playback(time, Listed([i * S // 100 for i in range(500)]))
    left: list[float] = []
    while not play.over:
        time.now = max(time.now, play.due() or 0) + S // 1000  # each late by 1 ms
        play.take()
        left.append((time.now - 100 * S) / S)
    assert left == pytest.approx([i / 100 + 0.001 for i in range(500)])
    assert play.status().slipped_s == 0


def test_pausing_while_the_consumer_blocks() -> None:
    """The position is that of the message on its way, so that nothing is overdue afterwards."""
    time = Time()
    play = playback(time, seconds(9))
    taken(play, time, until=0)
    time.now = play.due() or 0
    assert play.take() is not None
    time.now += 3 * S
    play.timeline.pause()
    assert play.status().offset_s == 1
    play.timeline.resume()
    assert taken(play, time, until=5) == [(5, "2")]


def test_loop() -> None:
    """From A up to but without B, each round exactly B - A long."""
    time = Time()
    play = playback(time, seconds(9), start=0.5, again=1.0, end=3.5)
    left = taken(play, time, until=9)
    assert left == [
        *[(0.5, "1"), (1.5, "2"), (2.5, "3")],
        *[(3, "1"), (4, "2"), (5, "3")],
        *[(5.5, "1"), (6.5, "2"), (7.5, "3")],
        *[(8, "1"), (9, "2")],
    ]
    assert play.status().rounds == 3


def test_loop_of_the_whole_log() -> None:
    """Without an end it turns at the last message of the log; a delay comes before every round."""
    time = Time()
    play = playback(time, seconds(3), again=0.0, delay_ns=S // 4)
    assert taken(play, time, until=4) == [(0.25, "0"), (1.25, "1"), (2.25, "2"), (2.5, "0"), (3.5, "1")]


def test_loops_do_not_drift() -> None:
    """Rounds begin where the one before ends on the timeline, not when somebody noticed."""
    time = Time()
    play = playback(time, seconds(3), again=0.0)
    began: list[int] = []
    while len(began) < 50:
        time.now = max(time.now, play.due() or 0) + S // 500
        played = play.take()
        began += [time.now] if played is not None and played.payload == b"0" else []
    assert [(b - a) / S for a, b in pairwise(began)] == pytest.approx([2] * 49, abs=0.01)


def test_a_loop_without_messages_ends() -> None:
    """Otherwise it would turn for ever, as fast as it can."""
    for rate in (None, 1.0):
        time = Time()
        play = playback(time, Listed([0, 9 * S]), start=1.0, again=1.0, end=3.0, rate=rate)
        assert taken(play, time) == []
        assert play.over
    play = playback(Time(), Listed([0, 9 * S]), start=1.0, again=1.0, end=3.0, paused=True)
    play.timeline.step()
    assert taken(play, Time()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": 5.0}, "nothing to play: start 5.000 s, end 2.000 s"),
        ({"start": 1.0, "end": 1.0}, "nothing to play"),
        ({"again": 2.0}, "nothing to loop: from 2.000 s to 2.000 s"),
        ({"rate": 1e-9}, "rate 1e-09 is not between"),
        ({"rate": -1.0}, "rate -1 is not between"),
        ({"rate": float("nan")}, "rate nan is not between"),
        ({"clock_hz": 0.0}, "a clock of 0 Hz"),
        ({"clock_hz": float("nan")}, "a clock of nan Hz"),
    ],
)
def test_what_cannot_be(options: dict[str, float], message: str) -> None:
    with pytest.raises(CommandError, match=message):
        playback(Time(), seconds(3), **options)


def test_latched_at_every_beginning() -> None:
    """Before the first message, after a seek also when paused, and in every round."""
    time = Time()
    source = Listed([i * S for i in range(6)], latched=[S // 2, 3 * S])
    play = playback(time, source, start=1.0, again=1.0, end=5.0)
    assert taken(play, time, until=5)[:6] == [(0, "latched"), *[(i, str(i + 1)) for i in range(4)], (4, "latched")]
    play.timeline.pause()
    play.seek(0)
    assert taken(play, time) == []
    play.seek(4 * S)
    assert taken(play, time) == [(5, "latched")]
    assert play.status().released == 9


def test_opening_a_log_is_no_lateness() -> None:
    """However long it takes to find the first message: it is due when it is there."""
    time = Time()

    class Slow(Listed):
        def begin(self, start: int, end: int | None) -> Generator[Played]:
            time.now += 3 * S
            return super().begin(start, end)

    play = playback(time, Slow([0, S, 2 * S]))
    assert taken(play, time, until=4) == [(3, "0"), (4, "1")]
    play.seek(S)
    assert taken(play, time) == [(7, "1"), (8, "2")]
    assert play.status().slipped_s == 0


def test_one_reading_at_a_time() -> None:
    """A seek closes what was being read, and so does the end."""
    time, source = Time(), seconds(9)
    play = playback(time, source, clock_hz=3.0)
    for t in (3, 2, 8):
        taken(play, time, until=round((time.now - 100 * S) / S) + 1)
        assert source.open == 1
        play.seek((1000 + t) * S)
    play.stop()
    assert play.over
    play.close()
    assert source.open == 0


def test_clock() -> None:
    """Ticks of event time between the messages, before those of the same time, at any rate; no step of their own."""
    time = Time()
    play = playback(time, Listed([0, S // 2, S // 2, S]), clock_hz=4.0, rate=10.0)
    tick = "\x00\x01\x00\x00"
    left = [(when, text if len(text) < 3 else text.startswith(tick)) for when, text in taken(play, time)]
    assert left == [
        *[(0, True), (0, "0"), (0.025, True), (0.05, True), (0.05, "1"), (0.05, "2")],
        *[(0.075, True), (0.1, True), (0.1, "3")],
    ]
    play = playback(time, Listed([0, S // 2, S]), clock_hz=4.0, paused=True)
    assert len(taken(play, time)) == 1  # where it stands
    play.timeline.step()
    assert [text for _, text in taken(play, time)] == ["0"]
    play.timeline.step()
    assert [len(text) for _, text in taken(play, time)] == [12, 12, 1]
