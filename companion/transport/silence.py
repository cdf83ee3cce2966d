"""What this computer itself can tell of a link on which nothing arrives: interface, cable, group, address."""

from __future__ import annotations

import fcntl
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from companion.transport.link import Link

_SIOCGIFADDR = 0x8915
"""Request of linux/sockios.h for the IPv4 address of an interface."""
_IGMP = Path("/proc/net/igmp")
_INTERFACES = Path("/sys/class/net")


class Silence(NamedTuple):
    """That nothing arrives on a link, in words, and where to look."""

    words: str
    remedy: str


def why_silent(link: Link) -> Silence:
    """Return what may be wrong where nothing arrives on a link, with what this computer shows of it."""
    if link.scheme == "serial":
        remedy = f"look at its baud rate ({link.baud}), the radio's net id and the cable"
        return Silence(f"nothing comes from {link.path}", remedy)
    if link.scheme == "file":
        return Silence(f"nothing is left in {link.path}", "name another log")
    words = f"nothing arrives on {link}"
    if link.scheme == "mcast":
        return Silence(
            words,
            f"the group is {_joined(link.host)}; the ground station must send there, and a switch that snoops "
            "IGMP needs a querier, or use udpbcast",
        )
    here = ", ".join(_interfaces()) or "no network"
    return Silence(
        words, f"this computer has {here}; look at the address the ground station sends to, and the firewall"
    )


def _joined(group: str, table: Path = _IGMP) -> str:
    """Return on which interfaces a group is joined, in words."""
    wanted = f"{struct.unpack('=I', socket.inet_aton(group))[0]:08X}"
    names: list[str] = []
    name = ""
    with suppress(OSError):
        for line in table.read_text(encoding="ascii", errors="replace").splitlines()[1:]:
            fields = line.split()
            if not line.startswith("\t") and len(fields) > 1:
                name = fields[1]
            elif fields and fields[0] == wanted:
                names.append(_interface(name))
    return f"joined on {', '.join(names)}" if names else "joined on no interface"


def _interfaces() -> list[str]:
    with suppress(OSError):
        return [_interface(name) for _, name in socket.if_nameindex() if name != "lo" and _address(name) is not None]
    return []


def _interface(name: str) -> str:
    """Return an interface with its address and, if that is so, that it has no carrier."""
    address = _address(name) or "no address"
    carrier = ""
    with suppress(OSError):
        carrier = (_INTERFACES / name / "carrier").read_text(encoding="ascii").strip()
    return f"{name} ({address}{', no carrier' if carrier == '0' else ''})"


def _address(name: str) -> str | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        answer = fcntl.ioctl(probe, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
        return socket.inet_ntoa(answer[20:24])
    return None
