"""Players of logs in the same network: what they play, and commands to them."""

from typing import Annotated, Literal

from fastapi import FastAPI, Path, Query, Response
from pydantic import BaseModel, Field

from fuselog.fusion.commands import CommandError
from fuselog.service.rest.asking import answer
from fuselog.service.rest.problems import Refused, documented
from fuselog.service.rest.served import Served
from fuselog.service.rest.waiting import Waiting

_WITHIN_S = 10.0
_MOST = 1e9  # s, and any other number here

PlayerName = Annotated[
    str, Path(pattern=r"^[^/\\*$?#;=\x00-\x1f\x7f]{1,128}$", description="as `fuselog play` says, or --name")
]
Command = Literal["pause", "resume", "toggle", "rate", "seek", "step", "burst", "stop"]
Rate = Annotated[
    float | None, Query(ge=0, le=_MOST, allow_inf_nan=False, description="of `rate`: times real time, or 0")
]
To = Annotated[
    str | None,
    Query(pattern=r"^[0-9A-Za-z:.+-]{1,64}$", description="of `seek`: a time, or seconds from the beginning"),
]
By = Annotated[float | None, Query(ge=-_MOST, le=_MOST, allow_inf_nan=False, description="of `seek`: s from here")]
Count = Annotated[int | None, Query(ge=1, le=int(_MOST), description="of `burst`: how many messages")]


class PlayerAnswer(BaseModel):
    """How a player stands."""

    player: str
    state: Literal["playing", "paused", "ended"]
    t_ns: int = Field(description="position, by the times of the log")
    offset_s: float = Field(description="the same from the beginning")
    length_s: float
    rate: float | None = Field(description="times real time; null as fast as possible")
    rounds: int = Field(description="of a loop")
    released: int = Field(description="messages")
    slipped_s: float = Field(description="by how much slow subscribers have put it off")


class PlayersAnswer(BaseModel):
    """All players that can be reached."""

    players: list[PlayerAnswer]


def add_players(app: FastAPI, served: Served, waiting: Waiting) -> None:
    """What plays logs into the service."""

    @app.get("/api/v1/players", tags=["players"], operation_id="players", response_model=PlayersAnswer)
    async def players() -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """All players in the network of the service."""
        return answer({"players": await waiting.run(served.players, within_s=_WITHIN_S)})

    @app.post(
        "/api/v1/players/{name}/{command}",
        tags=["players"],
        operation_id="command_player",
        response_model=PlayerAnswer,
        responses=documented(404, 408, 409, 413, 415),
    )
    async def command_player(  # pyright: ignore[reportUnusedFunction]  the same
        name: PlayerName, command: Command, value: Rate = None, to: To = None, by: By = None, count: Count = None
    ) -> Response:
        """Give a player a command; its status afterwards."""
        given = {"value": value, "to": to, "by": by, "count": count}
        arguments = {key: str(argument) for key, argument in given.items() if argument is not None}
        try:
            status = await waiting.run(lambda: served.play(name, command, arguments), within_s=_WITHIN_S)
        except KeyError:
            raise Refused(404, f"no player {name!r} answers") from None
        except CommandError as error:
            raise Refused(409, str(error)) from None
        return answer(status)
