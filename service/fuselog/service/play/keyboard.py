"""A player on a terminal: keys that command it, and one line that says how it stands."""

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager

from fuselog.replay.play import CommandError, Drive, Playback, Status

_LINE_EVERY_S = 0.3
_SEEK_NS = 10_000_000_000
_FASTER = 2.0
_CLEAR = "\r\x1b[K"
_ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}

HELP = """\
space  pause, go on        up, down   twice, half the rate
s      one message         left, b    10 s back
right  one message when paused, else 10 s on (f always)
?      these keys          q          quit
"""


def split_keys(typed: bytes) -> Iterator[str]:
    """The keys in what a terminal sends: characters, and arrows by name."""
    while typed:
        arrow = _ARROWS.get(typed[:3].replace(b"\x1bO", b"\x1b["))
        yield arrow or typed[:1].decode("latin-1")
        typed = typed[3:] if arrow else typed[1:]


def press(playback: Playback, key: str) -> None:
    """Do what a key stands for; raises ``CommandError`` when it cannot be. Other keys do nothing."""
    line = playback.timeline
    match key:
        case " ":
            line.toggle()
        case "s":
            line.step()
        case "right" if line.paused:
            line.step()
        case "right" | "f":
            playback.seek(line.position + _SEEK_NS)
        case "left" | "b":
            playback.seek(line.position - _SEEK_NS)
        case "up":
            line.set_rate((line.rate or 1.0) * _FASTER)
        case "down":
            line.set_rate((line.rate or 1.0) / _FASTER)
        case "q":
            playback.stop()
        case _:
            pass


def describe(status: Status) -> str:
    """How a player stands, in one line."""
    rate = "as fast as it is taken" if status.rate is None else f"{status.rate:g}x"
    parts = [f"{status.state:7}", f"{status.offset_s:.1f} of {status.length_s:.1f} s", rate]
    if status.rounds:
        parts.append(f"round {status.rounds + 1}")
    if status.slipped_s:
        parts.append(f"slowed by {status.slipped_s:.1f} s")
    return "  ".join(parts)


@contextmanager
def panel(drive: Drive, *, keys: bool) -> Generator[None]:
    """Keys and line while the block runs: ``keys`` when stdin is a terminal of ours, the line when stderr is one."""
    with ExitStack() as stack:
        source = sys.stdin.fileno() if keys and _has_keys() else None
        show = _show if sys.stderr.isatty() else None
        if source is not None:
            stack.enter_context(_unbuffered(source))
        if source is None and show is None:
            yield
            return
        ending, end = os.pipe()
        stack.callback(os.close, ending)
        thread = threading.Thread(target=_watch, args=(drive, source, ending, show), name="keyboard", daemon=True)
        thread.start()
        try:
            yield
        finally:
            os.close(end)
            thread.join()


def _watch(drive: Drive, source: int | None, ending: int, show: Callable[[str], None] | None) -> None:
    """Follow keys and renew the line until the pipe ``ending`` is closed."""
    say = show or _say_nothing
    files = [ending] if source is None else [ending, source]
    while True:
        say(describe(drive.command(Playback.status)))
        ready, _, _ = select.select(files, [], [], _LINE_EVERY_S)
        if ending in ready:
            say("")
            return
        if ready:
            typed = _read(ready[0])
            if not typed:  # the terminal is gone
                files = [ending]
            for key in split_keys(typed):
                _follow(drive, key, say)


def _read(file: int) -> bytes:
    try:
        return os.read(file, 64)
    except OSError:
        return b""


def _follow(drive: Drive, key: str, say: Callable[[str], None]) -> None:
    if key == "?":
        say(HELP)
        return
    try:
        drive.command(lambda playback: press(playback, key))
    except CommandError as error:
        say(f"{error}\n")


def _say_nothing(_: str) -> None:
    pass


def _show(text: str) -> None:
    sys.stderr.write(_CLEAR + text)
    sys.stderr.flush()


def _has_keys() -> bool:
    """Whether stdin is a terminal, and we are in its foreground: others who read from it are stopped."""
    try:
        return os.isatty(sys.stdin.fileno()) and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):  # closed, or replaced
        return False


@contextmanager
def _unbuffered(file: int) -> Generator[None]:
    """Keys as they are pressed, and unseen; Ctrl-C stays what it is."""
    before = termios.tcgetattr(file)
    tty.setcbreak(file)
    try:
        yield
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)
