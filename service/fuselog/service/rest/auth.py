"""Who may ask and who may change: bearer tokens with a role, kept as hashes, compared in constant time."""

import hmac
import os
import re
import secrets
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Literal

from fuselog.fusion.config import Problem, Source
from fuselog.service.rest.problems import Refused

Role = Literal["read", "control"]

_ROLES: dict[str, Role] = {"read": "read", "control": "control"}
_VARIABLES: dict[str, Role] = {"FUSELOG_TOKEN_READ": "read", "FUSELOG_TOKEN_CONTROL": "control"}
_LINE = re.compile(r"(\S+)\s+(\S+)\s+(\S+)")
_TOKEN = re.compile(r"[A-Za-z0-9._~+/=-]{43,512}")  # 32 random bytes in base64 are 43 characters
_NAME = re.compile(r"[A-Za-z0-9_.@-]{1,64}")
_HOW = "a line of a file (http.tokens) as `fuselog token` prints it, or the environment variable FUSELOG_TOKEN_CONTROL"


@dataclass(frozen=True, slots=True)
class Token:
    """Somebody who is known: by the hash of a secret, never by the secret."""

    role: Role
    name: str
    digest: bytes = field(repr=False)


@dataclass(slots=True)
class Access:
    """Who may do what. ``open``: reading needs no token, for only this machine can ask."""

    tokens: tuple[Token, ...] = ()
    open: bool = True

    def become(self, fresh: "Access") -> None:
        """Let those in that another lets in, from the next request on."""
        self.open = self.open and fresh.open  # never open to somebody whom neither of the two lets in
        self.tokens, self.open = fresh.tokens, fresh.open

    def check(self, who: Token | None, *, change: bool) -> None:
        """Raise ``Refused`` (401, 403) when they may not."""
        if who is None and change and not any(token.role == "control" for token in self.tokens):
            raise Refused(403, f"nothing can be changed: there is no token of role control. To make one: {_HOW}")
        if who is None and (change or not self.open):
            raise _unknown("a token is needed: Authorization: Bearer TOKEN")
        if who is not None and change and who.role != "control":
            raise Refused(403, f"the token {who.name!r} has the role {who.role}; this needs control")

    def identify(self, authorization: str | None) -> Token | None:
        """Who says so, None for who says nothing; raises ``Refused`` (401) for a token that is not known."""
        if authorization is None:
            return None
        scheme, _, secret = authorization.partition(" ")
        digest, found = sha256(secret.strip().encode("utf-8", "replace")).digest(), None
        for token in self.tokens:
            if hmac.compare_digest(token.digest, digest):
                found = token
        if found is None or scheme.lower() != "bearer":
            raise _unknown("the token is wrong")
        return found


def _unknown(detail: str) -> Refused:
    return Refused(401, detail, headers={"WWW-Authenticate": 'Bearer realm="fuselog"'})


def new_token(role: Role, name: str) -> str:
    """A line for the file of tokens; raises ``ValueError`` for a name that cannot be in it."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"not a name: {name!r} (letters, digits, _ . @ -)")
    return f"{role} {secrets.token_urlsafe(32)} {name}"


def read_tokens(source: Source, path: str | None, environment: Mapping[str, str]) -> tuple[Token, ...]:
    """The tokens of the file, which is beside the configuration, and of the environment.

    Raises ``ConfigError`` for a file that others can read, a line that is none, or a token that could be guessed. No
    secret is in a message.
    """
    problems: list[str] = []
    lines = [] if path is None else _lines(Path(source.name).parent / path, problems)
    tokens = [*_tokens(lines, problems), *_of_environment(environment, problems)]
    if problems:
        raise source.complain([Problem(("http", "tokens"), reason) for reason in problems])
    return tuple(tokens)


def check_private(path: Path) -> str | None:
    """Why a file with a secret cannot be used, None when only its owner can read it."""
    try:
        found = path.stat()
    except OSError as error:
        return f"{path}: {(error.strerror or str(error)).lower()}"
    if not stat.S_ISREG(found.st_mode):
        return f"{path}: not a file"
    if found.st_mode & 0o077:
        return f"{path}: others can read or write it (mode {stat.S_IMODE(found.st_mode):04o}); chmod 600 it"
    if found.st_uid not in (0, os.geteuid()):
        return f"{path}: belongs to another user"
    return None


def _lines(path: Path, problems: list[str]) -> list[tuple[int, str]]:
    reason = check_private(path)
    if reason is None:
        try:
            text = path.read_text(encoding="utf-8")
            return [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
        except (OSError, UnicodeDecodeError):
            reason = f"{path}: cannot be read"
    problems.append(reason)
    return []


def _tokens(lines: Iterable[tuple[int, str]], problems: list[str]) -> Iterable[Token]:
    names: set[str] = set()
    for number, line in lines:
        if not line or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        role = _ROLES.get(match[1]) if match is not None else None
        if match is None or role is None or not _NAME.fullmatch(match[3]):
            problems.append(f"line {number}: expected: read|control TOKEN NAME")
        elif not _TOKEN.fullmatch(match[2]):
            problems.append(f"line {number}: the token of {match[3]} could be guessed; take one of `fuselog token`")
        elif match[3] in names:
            problems.append(f"line {number}: {match[3]} has a token already")
        else:
            names.add(match[3])
            yield _token(role, match[3], match[2])


def _of_environment(environment: Mapping[str, str], problems: list[str]) -> Iterable[Token]:
    for name, role in _VARIABLES.items():
        secret = environment.get(name, "")
        if _TOKEN.fullmatch(secret):
            yield _token(role, name, secret)
        elif secret:
            problems.append(f"{name}: the token could be guessed; take one of `fuselog token`")


def _token(role: Role, name: str, secret: str) -> Token:
    return Token(role, name, sha256(secret.encode()).digest())
