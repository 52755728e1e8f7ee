"""Of several that claim the same estimate in the same moment exactly one gets it, wherever they meet."""

import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import pytest

from fuselog.service.live.ownership import Claim
from fuselog.service.transport import Endpoints, TransportError, open_session

PATIENCE_S, ROUNDS = 0.4, 2
TOPICS = ["fleet/{robot}/odom", "/fused/odom"]


def free() -> str:
    """An endpoint that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def client(at: str) -> Endpoints:
    """Of a router."""
    return Endpoints(mode="client", connect=[at])


def one_router(stack: ExitStack, count: int) -> list[Endpoints]:
    """All are clients of it."""
    at = free()
    stack.enter_context(open_session(Endpoints(mode="router", listen=[at]), timeout_s=5))
    return [client(at)] * count


def two_routers(stack: ExitStack, count: int) -> list[Endpoints]:
    """One is a client of the first, the others of the second."""
    first, second = free(), free()
    stack.enter_context(open_session(Endpoints(mode="router", listen=[first]), timeout_s=5))
    stack.enter_context(open_session(Endpoints(mode="router", listen=[second], connect=[first]), timeout_s=5))
    return [client(first), *[client(second)] * (count - 1)]


def peers(_: ExitStack, count: int) -> list[Endpoints]:
    """One listens, the others connect to it."""
    at = free()
    return [Endpoints(listen=[at]), *[Endpoints(connect=[at])] * (count - 1)]


def race(sessions: Sequence[Endpoints]) -> tuple[list[Claim], list[str]]:
    """Those who got it, and what the others were told."""
    held: list[Claim] = []
    refused: list[str] = []
    together = threading.Barrier(len(sessions))
    with ExitStack() as stack:
        opened = [stack.enter_context(open_session(at, timeout_s=5)) for at in sessions]

        def claim(number: int) -> None:
            together.wait()
            try:
                claim = Claim(opened[number], TOPICS, patience_s=PATIENCE_S)
                claim.hold()
                held.append(claim)
            except TransportError as error:
                refused.append(str(error))

        threads = [threading.Thread(target=claim, args=(number,)) for number in range(len(opened))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return held, refused


@pytest.mark.parametrize(("met", "count"), [(one_router, 2), (one_router, 3), (two_routers, 3), (peers, 2)])
def test_in_the_same_moment(met: Callable[[ExitStack, int], list[Endpoints]], count: int) -> None:
    """One goes on; the others say who has it."""
    with ExitStack() as stack:
        sessions = met(stack, count)
        for _ in range(ROUNDS):
            held, refused = race(sessions)
            assert len(held) == 1
            assert len(refused) == count - 1
            assert all(
                text.startswith(f"another service (process {os.getpid()} on ")
                and "'/fused/odom'" in text
                and text.endswith(" already (output: estimate)")
                for text in refused
            ), refused


def test_one_after_the_other() -> None:
    """Who is alone waits for the claim to be known and no longer; who comes later leaves it alone, until it ends."""
    at = free()
    with (
        open_session(Endpoints(listen=[at]), timeout_s=5) as ours,
        open_session(Endpoints(connect=[at]), timeout_s=5) as theirs,
    ):
        began = time.monotonic()
        first = Claim(ours, TOPICS)
        first.hold()
        assert 0.2 <= time.monotonic() - began < 1  # 0.3 s where nobody else uses the machine
        with pytest.raises(TransportError, match="another service"):
            Claim(theirs, TOPICS[1:], patience_s=PATIENCE_S)
        first.hold()
        Claim(theirs, ["another"], patience_s=PATIENCE_S).hold()
        first.end()
        token = ours.liveliness().declare_token("@fuselog/owner/fused/odom/of_another_form")
        with pytest.raises(TransportError, match=r"^another service publishes '/fused/odom' already"):
            Claim(theirs, TOPICS[1:], patience_s=PATIENCE_S)
        token.undeclare()
        Claim(theirs, TOPICS[1:], patience_s=PATIENCE_S).hold()
