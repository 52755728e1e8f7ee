"""Moments of a log as people write them."""

from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LARGEST_S = 10**10  # more seconds than a time in ns can count


def parse_moment(text: str, first_ns: int) -> int:
    """A moment in ns, exact.

    ``12.5`` counts seconds from ``first_ns``, the beginning of the log; ``@1700000000.25`` is Unix time;
    ``2023-11-14T22:13:20Z`` is ISO 8601, in UTC when it names no zone. Raises ValueError for anything else.
    """
    plain = text.strip()
    seconds = _seconds(plain.removeprefix("@"))
    if seconds is not None:
        return seconds + (0 if plain.startswith("@") else first_ns)
    try:
        when = datetime.fromisoformat(plain)
    except ValueError as error:
        raise ValueError(f"{text!r} is no time: seconds (12.5), Unix time (@1700000000.5) or ISO 8601") from error
    since = (when if when.tzinfo else when.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000


def _seconds(text: str) -> int | None:
    """A decimal number of seconds in ns; None when it is none."""
    try:
        number = Decimal(text)
    except InvalidOperation:
        return None
    if not number.is_finite() or not -_LARGEST_S <= number <= _LARGEST_S:
        return None
    return int((number * 10**9).to_integral_value())
