"""A run of the player from its parts: a source, a session, a timeline, and who commands it."""

import gc
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from fuselog.fusion.intake import same_topic
from fuselog.replay import Channel
from fuselog.replay.play import (
    CLOCK_TOPIC,
    TICKS,
    CommandError,
    Drive,
    Playback,
    Range,
    Source,
    Status,
    Timeline,
    clock_channel,
    parse_moment,
    ticker,
)
from fuselog.service.console import stderr
from fuselog.service.play.control import control
from fuselog.service.play.keyboard import panel
from fuselog.service.play.player import Player, Report
from fuselog.service.transport import Endpoints, open_session


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How time passes: ``rate`` None has no pacing, ``clock_hz`` None publishes no clock."""

    rate: float | None
    paused: bool
    delay_s: float
    clock_hz: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Commands:
    """Who may command: ``name`` is that of the player on Zenoh, None where nobody may; ``keys`` those of a terminal."""

    name: str | None
    keys: bool


def run(
    source: Source,
    channels: Sequence[Channel],
    names: Mapping[str, str],
    *,
    span: Range,
    pace: Pace,
    commands: Commands,
    at: Endpoints,
    wait_s: float,
) -> tuple[Report, Status]:
    """Play ``span`` of a source under ``names`` to whoever subscribes; raises ``TransportError`` when all leave."""
    if pace.clock_hz is not None:
        channels, names = [*channels, clock_channel()], {**names, TICKS: CLOCK_TOPIC}
    with open_session(at, timeout_s=max(wait_s, 1.0)) as session, ExitStack() as stack:
        player = Player(session, channels, names)
        if not player.wait_for_subscriber(wait_s):
            stderr.print("nobody subscribes to any topic; playing anyway")
        timeline = Timeline(
            span, time.monotonic_ns, rate=pace.rate, paused=pace.paused, delay_ns=round(pace.delay_s * 1e9)
        )
        playback = Playback(source, timeline, clock_hz=pace.clock_hz)
        drive = Drive(playback)
        if commands.name is not None:
            stack.callback(control(session, commands.name, drive))
        stack.enter_context(panel(drive, keys=commands.keys))
        gc.freeze()  # walking all that is loaded would hold up messages for tens of ms
        return player.play(drive, span), playback.status()


def range_of(
    source: Source,
    *,
    start: str,
    until: str | None = None,
    duration_s: float | None = None,
    loop: bool = False,
    loop_from: str | None = None,
) -> Range:
    """What is played, from moments as people write them; raises ``CommandError`` where they contradict each other."""
    begin = max(_moment("start", start, source), source.first)
    if until is not None and duration_s is not None:
        raise CommandError("only one of until and duration says where to end")
    if loop_from is not None and not loop:
        raise CommandError("from is for loops: give loop as well")
    end = _moment("until", until, source) if until is not None else None
    if duration_s is not None:
        end = begin + round(duration_s * 1e9)
    again = begin if loop_from is None else max(_moment("from", loop_from, source), source.first)
    return Range(first=source.first, last=source.last, start=begin, end=end, again=again if loop else None)


def clock_rate(text: str, names: Mapping[str, str]) -> float | None:
    """Ticks per second of the log, None for ``off``.

    Raises ``CommandError`` for anything else, and where a topic that is played would mix with the clock.
    """
    if text == "off":
        return None
    try:
        hz = float(text)
    except ValueError as error:
        raise CommandError(f"clock {text!r} is neither a number of Hz nor off") from error
    ticker(hz)
    for topic, name in names.items():
        if same_topic(name) == same_topic(CLOCK_TOPIC):
            ways = f"leave it out (--exclude {topic}), rename it (--remap {topic}:=/recorded_clock), or use --clock off"
            raise CommandError(f"the log has a clock of its own on {topic}: {ways}")
    return hz


def _moment(what: str, text: str, source: Source) -> int:
    try:
        return parse_moment(text, source.first)
    except ValueError as error:
        raise CommandError(f"{what}: {error}") from error
