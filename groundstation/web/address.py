"""Where the page is served: the address of `--ui`, whether only this computer reaches it, and the socket itself."""

from __future__ import annotations

import errno
import ipaddress
import socket
import time
from typing import NamedTuple

from companion.errors import InputError

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8750
DEFAULT_ADDRESS = f"{DEFAULT_HOST}:{DEFAULT_PORT}"
WAIT_S = 1.0
"""Time for which an address in use is tried again: the page's process of a run that was killed ends after it."""
_AGAIN_S = 0.05
_MOST_WAITING = 128
"""Greatest number of connections that wait to be accepted."""
_FORM = "HOST:PORT, such as 127.0.0.1:8750 or [::1]:8750"


class Address(NamedTuple):
    """Address on which the page is served; port 0 takes any free one."""

    host: str = DEFAULT_HOST
    port: int = DEFAULT_PORT

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this computer can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def parse_address(text: str, option: str = "--ui") -> Address:
    """Return the address that HOST:PORT, HOST or :PORT names.

    Raises:
        InputError: it is no address.

    """
    host, port = _halves(text)
    if port and not (port.isascii() and port.isdigit() and int(port) <= 65_535):
        raise InputError(f"{option}: '{text}': port '{port}'; allowed: {_FORM}, with a port from 0 to 65535")
    if any(letter.isspace() or letter in "/@?#" for letter in host):
        raise InputError(f"{option}: '{text}'; allowed: {_FORM}")
    return Address(host or DEFAULT_HOST, int(port) if port else DEFAULT_PORT)


def _halves(text: str) -> tuple[str, str]:
    """Return host and port as they stand in HOST:PORT; an empty one was left out."""
    if text.startswith("["):
        host, _, rest = text[1:].partition("]")
        return host, rest.removeprefix(":")
    if text.count(":") > 1:
        return text, ""
    host, _, port = text.partition(":")
    return host, port


def listen(address: Address, option: str = "--ui") -> socket.socket:
    """Return a socket that listens on an address, for which a killed run's page is waited for as long as WAIT_S.

    Raises:
        InputError: nothing can listen there.

    """
    try:
        listener = _created(address)
    except (OSError, OverflowError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{option}: '{address}': {reason}; allowed: a free port of this computer") from error
    listener.setblocking(False)
    return listener


def _created(address: Address) -> socket.socket:
    family, _, _, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
    gives_up_s = time.monotonic() + WAIT_S
    while True:
        try:
            return socket.create_server(place[:2], family=family, backlog=_MOST_WAITING)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or time.monotonic() > gives_up_s:
                raise
        time.sleep(_AGAIN_S)


def bound(listener: socket.socket) -> Address:
    """Return the address on which a socket listens."""
    host, port = listener.getsockname()[:2]
    return Address(host, port)
