"""Zenoh's security as the configuration wants it: files looked at one by one, then values of Zenoh's configuration."""

import os
import ssl
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import orjson
import zenoh

from fuselog.fusion.config import Problem, Source
from fuselog.fusion.config.settings import TlsSettings, ZenohSettings
from fuselog.service.zenoh_door import read_value, reason_of

TLS: Final = "transport/link/tls"
USER: Final = "transport/auth/usrpwd"
_NAMED: Final = {  # paths that have a setting of their own
    "mode": "mode",
    "listen/endpoints": "listen",
    "connect/endpoints": "connect",
    "scouting/multicast/enabled": "multicast",
    TLS: "tls",
    USER: "user, password_file and users_file",
    "access_control": "access",
    "low_pass_filter": "max_payload",
}


def security(settings: ZenohSettings, source: Source, *, serves: bool) -> dict[str, Any]:
    """Values by path of Zenoh's configuration; of whom we let in and what they may do only where we serve.

    Relative paths are from the folder of the configuration. Raises ``ConfigError`` for files that are missing or
    wrong, and secrets that others can read, all at their places.
    """
    files = _Files(Path(source.name).parent)
    _check_endpoints(settings, files, serves=serves)
    values: dict[str, Any] = {}
    if settings.tls is not None:
        values |= _tls(settings.tls, files)
    values |= _user(settings, files)
    if serves:
        values |= _users(settings, files) | _access(settings, files) | _limit(settings)
    values |= _raw(settings, files)
    if files.problems:
        raise source.complain(files.problems)
    return values


class _Files:
    """Looks at files, and keeps what is wrong with them."""

    def __init__(self, folder: Path) -> None:
        self.problems: list[Problem] = []
        self._folder = folder

    def wrong(self, *place: str, reason: str) -> None:
        """Something is wrong at this place of ``zenoh``."""
        self.problems.append(Problem(("zenoh", *place), reason))

    @contextmanager
    def reading(self, *place: str) -> Generator[None]:
        """Whatever is raised inside is wrong at this place."""
        try:
            yield
        except ssl.SSLError as error:
            self.wrong(*place, reason=f"not what it should be: {error.reason or error}")
        except OSError as error:
            self.wrong(*place, reason=f"{error.filename}: {error.strerror}")
        except zenoh.ZError as error:
            self.wrong(*place, reason=reason_of(error))
        except ValueError as error:
            self.wrong(*place, reason=str(error))

    def file(self, name: str) -> Path:
        """The absolute path of a file that can be read."""
        path = (self._folder / name).absolute()
        with path.open("rb"):
            return path

    def secret(self, name: str) -> Path:
        """The same, which nobody else can read; where root owns it, our group may, as containers have it."""
        path = self.file(name)
        status = path.stat()
        others = 0o037 if status.st_uid == 0 != os.geteuid() else 0o077
        if status.st_mode & others:
            raise ValueError(f"{path}: others can read it (mode {status.st_mode & 0o777:04o}); chmod 600 {path.name}")
        return path


def _check_endpoints(settings: ZenohSettings, files: _Files, *, serves: bool) -> None:
    certified = settings.tls is not None and settings.tls.certificate is not None
    for place, endpoints in (("listen", settings.listen), ("connect", settings.connect)):
        secured = [endpoint for endpoint in endpoints if endpoint.startswith(("tls/", "quic/"))]
        if secured and settings.tls is None:
            files.wrong(place, reason=f"{secured[0]} needs certificates (tls)")
        elif secured and serves and place == "listen" and not certified:
            files.wrong("tls", reason=f"to listen on {secured[0]} needs a certificate and its key")


def _tls(tls: TlsSettings, files: _Files) -> dict[str, Any]:
    values: dict[str, Any] = {f"{TLS}/enable_mtls": tls.mutual, f"{TLS}/verify_name_on_connect": tls.verify_name}
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    with files.reading("tls", "ca"):
        path = files.file(tls.ca)
        context.load_verify_locations(path)
        values[f"{TLS}/root_ca_certificate"] = str(path)
    if tls.certificate is None or tls.key is None:
        if tls.certificate != tls.key:
            files.wrong("tls", reason="certificate and key go together")
        elif tls.mutual:
            files.wrong("tls", reason="mutual needs a certificate and its key; without them say mutual: false")
        return values
    with files.reading("tls", "certificate"):
        certificate = files.file(tls.certificate)
        with files.reading("tls", "key"):
            key = files.secret(tls.key)
            context.load_cert_chain(certificate, key, password=_refuse_password)
            for role in ("listen", "connect"):
                values |= {f"{TLS}/{role}_certificate": str(certificate), f"{TLS}/{role}_private_key": str(key)}
    return values


def _refuse_password() -> str:
    raise ValueError("the key has a password, which Zenoh cannot ask for")


def _user(settings: ZenohSettings, files: _Files) -> dict[str, Any]:
    if settings.password_file is not None and settings.password_env is not None:
        files.wrong("password_env", reason="the password is in a file or in the environment, not in both")
    elif settings.password_file is None and settings.password_env is None:
        if settings.user is not None:
            files.wrong("user", reason="needs a password: password_file or password_env")
    elif settings.user is None:
        files.wrong("password_file" if settings.password_file else "password_env", reason="needs a user")
    else:
        return {f"{USER}/user": settings.user, f"{USER}/password": _password(settings, files)}
    return {}


def _password(settings: ZenohSettings, files: _Files) -> str:
    if settings.password_file is None:
        name = settings.password_env or ""
        if not os.environ.get(name):
            files.wrong("password_env", reason=f"the environment has no {name}")
        return os.environ.get(name, "")
    text = ""
    with files.reading("password_file"):
        path = files.secret(settings.password_file)
        text = path.read_text(encoding="utf-8").strip("\r\n")
        if not text or "\n" in text:
            raise ValueError(f"{path}: expected one line, the password")
    return text


def _users(settings: ZenohSettings, files: _Files) -> dict[str, Any]:
    if settings.users_file is None:
        return {}
    with files.reading("users_file"):
        path = files.secret(settings.users_file)
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            user, _, password = line.partition(":")
            if line and not (user and password):
                raise ValueError(f"{path}:{number}: expected user:password")
        return {f"{USER}/dictionary_file": str(path)}
    return {}


def _access(settings: ZenohSettings, files: _Files) -> dict[str, Any]:
    if settings.access is None:
        return {}
    with files.reading("access"):
        path = files.file(settings.access)
        try:
            rules = read_value("access_control", path.read_text(encoding="utf-8"))
        except zenoh.ZError as error:
            raise ValueError(f"{path}: {reason_of(error)}") from error
        if not rules["enabled"]:
            raise ValueError(f"{path}: says enabled: false, or does not say enabled: true; nothing would be refused")
        return {"access_control": rules}
    return {}


def _limit(settings: ZenohSettings) -> dict[str, Any]:
    if settings.max_payload is None:
        return {}
    scope = {"id": "max_payload", "flows": ["ingress"], "messages": ["put"], "key_exprs": ["**"]}
    return {"low_pass_filter": [{**scope, "size_limit": settings.max_payload}]}


def _raw(settings: ZenohSettings, files: _Files) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for path, value in settings.raw.items():
        named = [setting for own, setting in _NAMED.items() if _overlap(own, path)]
        if named:
            files.wrong("raw", path, reason=f"has a setting of its own: {named[0]}")
            continue
        with files.reading("raw", path):
            values[path] = read_value(path, orjson.dumps(value).decode())
    return values


def _overlap(path: str, other: str) -> bool:
    """Whether one is the other or lies in it."""
    return f"{path}/".startswith(f"{other}/") or f"{other}/".startswith(f"{path}/")
