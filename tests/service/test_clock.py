"""The clock of arrivals, while somebody sets that of the machine."""

import time

import pytest

from fuselog.service.clock import never_back

HOUR = 3600 * 10**9


def test_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ahead it follows at once; set back it goes on at its own pace, and waits for nobody."""
    wall, set_by = time.time_ns, [0]
    monkeypatch.setattr(time, "time_ns", lambda: wall() + set_by[0])
    now_ns = never_back()
    assert abs(now_ns() - wall()) < 10**8
    set_by[0] = HOUR
    assert abs(now_ns() - wall() - HOUR) < 10**8
    set_by[0] = -HOUR
    before = now_ns()
    time.sleep(0.05)
    assert 5 * 10**7 <= now_ns() - before < 10**9
    assert abs(now_ns() - wall() - HOUR) < 10**8
