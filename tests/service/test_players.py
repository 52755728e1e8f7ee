"""Players as the service sees them: what answers in another form is no player."""

import socket
from collections.abc import Iterator

import orjson
import pytest
import zenoh

from fuselog.fusion.commands import CommandError
from fuselog.service.play.remote import command_player, players
from fuselog.service.transport import Endpoints, open_session

GOOD = {
    "schema": 1,
    "player": "good",
    "command": "status",
    "state": "paused",
    "t_ns": 1,
    "offset_s": 0.0,
    "length_s": 2.0,
    "rate": None,
    "rounds": 0,
    "released": 3,
    "slipped_s": 0.0,
}


@pytest.fixture
def here() -> Iterator[zenoh.Session]:
    """A session that sees four players, of which one answers as it should, and one refuses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    there, mine = Endpoints(listen=[endpoint]), Endpoints(mode="client", connect=[endpoint])
    answers = {"good": orjson.dumps(GOOD), "torn": b"{", "list": b"[1]"}
    with open_session(there, timeout_s=10) as players_there, open_session(mine, timeout_s=10) as session:
        for name, text in answers.items():

            def reply(query: zenoh.Query, text: bytes = text) -> None:
                with query:
                    query.reply(query.key_expr if "*" not in str(query.key_expr) else "@fuselog/player/x/status", text)

            players_there.declare_queryable(f"@fuselog/player/{name}/*", reply)

        def refuse(query: zenoh.Query) -> None:
            with query:
                query.reply_err(b'{"error": "not now"}')

        players_there.declare_queryable("@fuselog/player/busy/*", refuse)
        yield session


def test_only_players_are_players(here: zenoh.Session) -> None:
    """Garbage is passed over in the list, and an error where it was asked for by name."""
    expected = {key: value for key, value in GOOD.items() if key not in ("schema", "command")}
    for _ in range(50):
        if (found := players(here)) == [expected]:
            break
    assert found == [expected]
    assert command_player(here, "good", "pause", {}) == expected
    for name in ("torn", "list"):
        with pytest.raises(CommandError, match="in a form that is not known"):
            command_player(here, name, "pause", {})
    with pytest.raises(CommandError, match="not now"):
        command_player(here, "busy", "pause", {})
    with pytest.raises(KeyError):
        command_player(here, "nobody", "pause", {})
