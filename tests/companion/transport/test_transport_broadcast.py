"""Subnet broadcast and multicast: several receivers on one computer, and a sender that no replier can capture."""

from __future__ import annotations

import socket
from collections.abc import Awaitable, Callable

import pytest

from companion.errors import InputError
from companion.transport.endpoints import OnDatagram, Receiver, open_receiver, open_sender, parse_link
from tests.companion.transport.end_points import run, until

LOCALHOST = "127.0.0.1"
GROUP = "239.255.145.50"
SEVERAL = ["udpbcast:127.255.255.255:{port}", f"mcast:{GROUP}:{{port}}@{LOCALHOST}"]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("form", SEVERAL)
def test_all_receivers_on_one_computer_hear_everything(form: str) -> None:
    async def body() -> None:
        link = parse_link(form.format(port=free_port()))
        heard: list[list[bytes]] = [[], [], []]
        receivers = [await open_receiver(link, one.append) for one in heard]
        sender = await open_sender(link)
        sent = [bytes([index]) * 200 for index in range(50)]
        for datagram in sent:
            sender.send(datagram)
        await until(lambda: all(len(one) == 50 for one in heard))
        assert heard == [sent] * 3
        sender.close()
        for receiver in receivers:
            receiver.close()

    run(body)


@pytest.mark.parametrize("form", SEVERAL)
def test_a_receiver_that_ends_takes_nothing_from_the_others(form: str) -> None:
    async def body() -> None:
        link = parse_link(form.format(port=free_port()))
        heard: list[bytes] = []
        first, second = await open_receiver(link, lambda _: None), await open_receiver(link, heard.append)
        sender = await open_sender(link)
        first.close()
        sender.send(b"still here")
        await until(lambda: heard == [b"still here"])
        second.close()
        sender.close()

    run(body)


@pytest.mark.parametrize("form", SEVERAL)
def test_a_sender_goes_on_to_everybody_after_somebody_answered(form: str) -> None:
    async def body() -> None:
        link = parse_link(form.format(port=free_port()))
        heard: list[bytes] = []
        receiver = await open_receiver(link, heard.append)
        sender = await open_sender(link)
        with joined(link.host, link.port) as replier:
            for index in range(100):
                sender.send(bytes([index]))
                _, sender_address = replier.recvfrom(100)
                replier.sendto(b"talk to me alone", sender_address)
        await until(lambda: len(heard) == 100)
        assert heard == [bytes([index]) for index in range(100)]
        assert sender.counts.sent == 100
        receiver.close()
        sender.close()

    run(body)


def joined(host: str, port: int) -> socket.socket:
    """Return a socket that hears what is sent to a broadcast address or a group, and can answer."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind((host, port))
    if host == GROUP:
        membership = socket.inet_aton(GROUP) + socket.inet_aton(LOCALHOST)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    sock.settimeout(2.0)
    return sock


def test_whoever_listens_to_every_address_hears_the_broadcast() -> None:
    async def body() -> None:
        port = free_port()
        heard: list[bytes] = []
        receivers = [
            await open_receiver(parse_link(f"{form}:{port}"), heard.append)
            for form in ("udpbcast:0.0.0.0", "udpbcast:127.255.255.255")
        ]
        sender = await open_sender(parse_link(f"udpbcast:127.255.255.255:{port}"))
        sender.send(b"all")
        await until(lambda: heard == [b"all", b"all"])
        sender.close()
        for receiver in receivers:
            receiver.close()

    run(body)


def test_one_group_does_not_leak_into_another_on_the_same_port() -> None:
    async def body() -> None:
        port = free_port()
        heard: dict[str, list[bytes]] = {"239.255.1.1": [], "239.255.1.2": []}
        links = {group: parse_link(f"mcast:{group}:{port}@{LOCALHOST}") for group in heard}
        receivers: list[Receiver] = []
        for group, link in links.items():
            take: OnDatagram = heard[group].append
            receivers.append(await open_receiver(link, take))
        for group, link in links.items():
            sender = await open_sender(link)
            sender.send(group.encode())
            sender.close()
        await until(lambda: all(heard.values()))
        assert heard == {group: [group.encode()] for group in links}
        for receiver in receivers:
            receiver.close()

    run(body)


def test_a_multicast_datagram_never_leaves_its_network(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[socket.socket] = []

    class WatchedSocket(socket.socket):
        def __init__(self, *arguments: int) -> None:
            super().__init__(*arguments)
            opened.append(self)

    monkeypatch.setattr(socket, "socket", WatchedSocket)

    async def body() -> None:
        sender = await open_sender(parse_link(f"mcast:{GROUP}:{free_port()}@{LOCALHOST}"))
        assert opened[-1].getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 1
        chosen = opened[-1].getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
        assert socket.inet_ntoa(chosen) == LOCALHOST
        sender.close()

    run(body)


@pytest.mark.parametrize("host", [LOCALHOST, "127.0.0.2"])
@pytest.mark.parametrize("opening", [open_sender, lambda link: open_receiver(link, lambda _: None)])
def test_broadcasting_to_one_computer_alone_is_refused(host: str, opening: Callable[..., Awaitable[object]]) -> None:
    async def body() -> None:
        with pytest.raises(InputError, match=f"{host} is not the broadcast address of a network of this computer"):
            await opening(parse_link(f"udpbcast:{host}:14550"))

    run(body)


def test_an_interface_that_this_computer_does_not_have_is_an_error_in_one_line() -> None:
    async def body() -> None:
        link = parse_link(f"mcast:{GROUP}:{free_port()}@192.0.2.1")
        for opening in (open_sender(link), open_receiver(link, lambda _: None)):
            with pytest.raises(InputError, match=r"192\.0\.2\.1 is not an address of this computer"):
                await opening

    run(body)
