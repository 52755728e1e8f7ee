"""Why a Zenoh endpoint does not let us in, in one line: Zenoh itself only says that it could not connect."""

import socket
import ssl
from collections.abc import Mapping
from typing import Any, Final

from fuselog.service.security import TLS, USER

_PATIENCE_S: Final = 1.0
_VERDICT_S: Final = 0.3  # in which a server says that it does not like our certificate
_STREAMS: Final = ("tcp", "tls", "ws")  # others cannot be asked


def why_refused(endpoint: str, options: Mapping[str, Any]) -> str:
    """What a connection to ``endpoint`` meets with these values of Zenoh's configuration by path."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol not in _STREAMS or not port.isdigit():
        return f"{endpoint}: nobody answers, or does not let us in"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S) as connection:
            said = _shake_hands(connection, host.strip("[]"), options) if protocol == "tls" else ""
    except OSError:
        return f"nobody answers at {endpoint}: is `fuselog serve` or a Zenoh router running there?"
    return f"{endpoint}: {said or _not_let_in(options)}"


def _shake_hands(connection: socket.socket, host: str, options: Mapping[str, Any]) -> str:
    """What is wrong with their certificate or ours; empty when nothing is."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = bool(options.get(f"{TLS}/verify_name_on_connect", True))
    context.load_verify_locations(options[f"{TLS}/root_ca_certificate"])
    if f"{TLS}/connect_certificate" in options:
        context.load_cert_chain(options[f"{TLS}/connect_certificate"], options[f"{TLS}/connect_private_key"])
    try:
        with context.wrap_socket(connection, server_hostname=host) as secured:
            secured.settimeout(_VERDICT_S)
            secured.recv(1)  # in TLS 1.3 the server looks at our certificate after the handshake
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is not accepted: {error.verify_message}"
    except TimeoutError:
        return ""  # it waits for us to speak
    except ssl.SSLError as error:
        said = (error.reason or str(error)).lower().replace("_", " ")
        return f"it does not accept our certificate, or we have none: {said}"
    except OSError:
        return "it breaks off while certificates are exchanged"
    return ""


def _not_let_in(options: Mapping[str, Any]) -> str:
    user = options.get(f"{USER}/user")
    who = f"user {user!r} or the password is wrong" if user else "it may want a user and password"
    return f"it answers but does not let us in: {who}, or it is no Zenoh endpoint of this protocol"
