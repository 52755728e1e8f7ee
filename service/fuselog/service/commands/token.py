"""``fuselog token``: a secret for who may ask the service, or change it."""

import sys
from typing import Annotated, Literal

import typer


def token(
    name: Annotated[str, typer.Argument(help="Whose it is; said in the audit log.")],
    role: Annotated[
        Literal["read", "control"], typer.Option(help="What it allows; control includes reading.")
    ] = "read",
) -> None:
    """Print a fresh line for the file of tokens (http.tokens), which only its owner may read.

    fuselog token alice --role control >> tokens; chmod 600 tokens
    """
    from fuselog.service.rest.auth import new_token  # noqa: PLC0415  slow to import

    try:
        sys.stdout.write(new_token(role, name) + "\n")
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="NAME") from error
