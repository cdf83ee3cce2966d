"""The end points: who may write, who is answered, and that nothing the network does raises."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.transport.endpoints import (
    ALLOWED,
    DUPLEX,
    RECEIVE_BUFFER_BYTES,
    RECEIVING,
    SCHEMES,
    SENDING,
    Address,
    Link,
    Receiver,
    UdpSender,
    open_duplex,
    open_receiver,
    open_sender,
    parse_link,
)
from companion.transport.udp import MAX_PER_WAKE, UdpDuplex
from tests.companion.transport.end_points import run, until
from tests.ports import free_port

LOCALHOST = "127.0.0.1"


@asynccontextmanager
async def plain_socket() -> AsyncIterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((LOCALHOST, 0))
        sock.setblocking(False)
        yield sock


HOSTS = st.from_regex(r"[a-z0-9.-]{1,20}", fullmatch=True)
PORTS = st.integers(1, 65535)
GROUPS = st.tuples(st.integers(224, 239), *[st.integers(0, 255)] * 3).map(lambda parts: ".".join(map(str, parts)))
PATHS = st.from_regex(r"/[a-zA-Z0-9_:. /-]{1,30}", fullmatch=True)
LINKS = st.one_of(
    st.builds(Link, st.sampled_from(["udpin", "udpbcast"]), HOSTS, PORTS),
    st.builds(
        lambda addresses: Link("udpout", addresses[0][0], addresses[0][1], tuple(addresses[1:])),
        st.lists(st.tuples(HOSTS, PORTS), min_size=1, max_size=4, unique=True),
    ),
    st.builds(Link, st.just("mcast"), GROUPS, PORTS, interface=st.sampled_from(["", "127.0.0.1", "10.1.2.3"])),
    st.builds(Link, st.just("serial"), path=PATHS, baud=st.sampled_from([1200, 57600, 115200])),
    st.builds(Link, st.just("file"), path=PATHS.map(lambda path: f"{path}.tlog")),
)


@pytest.mark.slow
@given(LINKS)
def test_a_link_is_what_its_text_says(link: Link) -> None:
    assert parse_link(str(link)) == link


@pytest.mark.parametrize(
    "text",
    [
        "udpin:0.0.0.0:14550",
        "udpout:10.0.0.2:14550,10.0.0.3:14551",
        "udpbcast:192.168.1.255:14550",
        "mcast:239.255.145.50:14550",
        "mcast:239.255.145.50:14550@10.0.0.1",
        "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0:57600",
        "file:flight.tlog",
        "tcp:127.0.0.1:5760",
    ],
)
def test_a_link_prints_as_it_was_written(text: str) -> None:
    assert str(parse_link(text)) == text


def test_a_serial_device_may_be_written_as_for_pymavlink() -> None:
    assert parse_link("/dev/ttyUSB0,57600") == parse_link("serial:/dev/ttyUSB0:57600")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("udpinn:127.0.0.1:14550", "unknown scheme 'udpinn'.*did you mean 'udpin'"),
        ("UDPOUT:127.0.0.1:14550", "unknown scheme 'UDPOUT'.*did you mean 'udpout'"),
        ("sctp:127.0.0.1:5760", "unknown scheme 'sctp'; allowed: udpin:HOST:PORT"),
        ("tcp:127.0.0.1", "host or port missing; allowed: tcp:HOST:PORT"),
        ("", "unknown scheme ''"),
        ("udpin:127.0.0.1", "host or port missing"),
        ("udpin::14550", "host or port missing"),
        ("udpin://127.0.0.1:14550", "no host name"),
        ("udpin:a b:14550", "no host name"),
        ("udpin:127.0.0.1:", "port '' is not a number"),
        ("udpin:127.0.0.1:0", "port '0' is not a number from 1 to 65535"),
        ("udpin:127.0.0.1:65536", "from 1 to 65535"),
        ("udpin:127.0.0.1:-1", "from 1 to 65535"),
        ("udpin:127.0.0.1:1e3", "from 1 to 65535"),
        ("udpin:127.0.0.1:٣", "from 1 to 65535"),
        ("udpin:127.0.0.1:1,127.0.0.1:2", "2 addresses; allowed: udpin:HOST:PORT"),
        ("udpbcast:10.0.0.255:1,10.0.1.255:1", "2 addresses; allowed: udpbcast:HOST:PORT"),
        ("udpout:127.0.0.1:1,", "host or port missing; allowed: udpout:HOST:PORT"),
        ("udpout:127.0.0.1:1,127.0.0.1:1", "an address is there twice"),
        ("mcast:10.0.0.1:14550", "'10.0.0.1' is no group; allowed: .*224.0.0.0"),
        ("mcast:all:14550", "'all' is no group"),
        ("mcast:14550", "host or port missing"),
        ("mcast:239.1.1.1:14550@eth0", "interface 'eth0' is no IPv4 address"),
        ("mcast:239.1.1.1:14550@", "interface '' is no IPv4 address"),
        ("serial:/dev/ttyUSB0", "allowed: serial:DEVICE:BAUD"),
        ("serial:ttyUSB0:57600", "'ttyUSB0' is no device's full path"),
        ("serial:/dev/ttyUSB0:57601", "baud rate '57601'; allowed: .*57600"),
        ("/dev/ttyUSB0,", "baud rate ''"),
        ("/dev/ttyUSB0", "unknown scheme"),
        ("file:flight.bin", "'flight.bin' is no telemetry log's name; allowed: file:PATH.tlog"),
    ],
)
def test_a_bad_link_is_refused_in_one_line_with_what_is_allowed(text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        parse_link(text)
    assert "\n" not in str(caught.value)
    assert "allowed: " in str(caught.value)


def test_an_unknown_scheme_is_told_every_form() -> None:
    with pytest.raises(InputError) as caught:
        parse_link("sctp:127.0.0.1:5760")
    assert ALLOWED in str(caught.value)


@pytest.mark.slow
@given(st.text(max_size=40))
def test_any_text_is_a_link_or_an_input_error(text: str) -> None:
    try:
        parse_link(text)
    except InputError:
        return


def test_a_sender_reaches_a_receiver() -> None:
    async def body() -> None:
        heard: list[bytes] = []
        port = free_port()
        receiver = await open_receiver(Link("udpin", LOCALHOST, port), heard.append)
        sender = await open_sender(Link("udpout", "localhost", port))
        sender.send(b"one")
        await until(lambda: heard == [b"one"])
        assert sender.counts.sent == 1
        sender.close()
        receiver.close()

    run(body)


def test_a_receiver_has_no_way_to_send() -> None:
    assert [name for name in dir(Receiver) if not name.startswith("_")] == ["close"]


@pytest.mark.parametrize("scheme", ["udpin", "udpbcast", "mcast"])
def test_the_kernel_refuses_to_write_on_a_receivers_socket(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[socket.socket] = []

    class WatchedSocket(socket.socket):
        def __init__(self, *arguments: int) -> None:
            super().__init__(*arguments)
            opened.append(self)

    monkeypatch.setattr(socket, "socket", WatchedSocket)
    hosts = {"udpin": LOCALHOST, "udpbcast": "127.255.255.255", "mcast": "239.255.145.50"}

    async def body() -> None:
        port = free_port()
        link = Link(scheme, hosts[scheme], port, interface=LOCALHOST if scheme == "mcast" else "")
        receiver = await open_receiver(link, lambda _: None)
        with pytest.raises(BrokenPipeError):
            opened[-1].sendto(b"must not leave", (LOCALHOST, port))
        receiver.close()

    run(body)


def test_what_a_receiver_hands_a_datagram_to_may_close_it() -> None:
    async def body() -> None:
        heard: list[bytes] = []

        def take(datagram: bytes) -> None:
            heard.append(datagram)
            receiver.close()

        port = free_port()
        receiver = await open_receiver(Link("udpin", LOCALHOST, port), take)
        async with plain_socket() as talker:
            for _ in range(3):
                talker.sendto(b"x", (LOCALHOST, port))
        await until(lambda: bool(heard))
        await asyncio.sleep(0.01)
        assert heard == [b"x"]
        receiver.close()

    run(body)


def test_a_flood_leaves_others_on_the_event_loop_their_turn() -> None:
    async def body() -> None:
        heard: list[int] = []
        port = free_port()
        receiver = await open_receiver(Link("udpin", LOCALHOST, port), lambda _: heard.append(0))
        async with plain_socket() as talker:
            for _ in range(3 * MAX_PER_WAKE):
                talker.sendto(b"flood", (LOCALHOST, port))
        seen = []
        while len(heard) < 3 * MAX_PER_WAKE:
            await asyncio.sleep(0.0)
            seen.append(len(heard))
        assert max(later - earlier for earlier, later in itertools.pairwise([0, *seen])) == MAX_PER_WAKE
        receiver.close()

    run(body)


def test_a_sender_to_a_list_reaches_everybody_on_it() -> None:
    async def body() -> None:
        async with plain_socket() as first, plain_socket() as second:
            ports = [sock.getsockname()[1] for sock in (first, second)]
            sender = await open_sender(parse_link(f"udpout:{LOCALHOST}:{ports[0]},localhost:{ports[1]}"))
            sender.send(b"to all")
            assert (first.recv(100), second.recv(100)) == (b"to all", b"to all")
            assert sender.counts.sent == 2
            sender.close()

    run(body)


def test_a_sender_keeps_to_its_destination_when_somebody_answers() -> None:
    async def body() -> None:
        async with plain_socket() as listener, plain_socket() as stranger:
            sender = await open_sender(Link("udpout", LOCALHOST, listener.getsockname()[1]))
            sender.send(b"first")
            await until(lambda: sender.counts.sent == 1)
            data, sender_address = listener.recvfrom(100)
            stranger.sendto(b"talk to me", sender_address)
            listener.sendto(b"and to me", sender_address)
            await asyncio.sleep(0.02)
            sender.send(b"second")
            assert (data, listener.recv(100)) == (b"first", b"second")
            with pytest.raises(BlockingIOError):
                stranger.recv(100)
            sender.close()

    run(body)


def test_a_sender_to_nobody_goes_on() -> None:
    async def body() -> None:
        port = free_port()
        sender = await open_sender(Link("udpout", LOCALHOST, port))
        for _ in range(5):
            sender.send(b"lost")
            await asyncio.sleep(0.005)
        assert sender.counts.sent + sender.counts.refused == 5
        sender.close()

    run(body)


class BrokenSocket:
    """A socket whose sending always fails in one way."""

    def __init__(self, error: OSError) -> None:
        self.error = error

    def sendto(self, _data: bytes, _address: tuple[str, int]) -> int:
        raise self.error


@pytest.mark.parametrize(
    ("error", "field"),
    [(BlockingIOError(), "full"), (ConnectionRefusedError(), "refused"), (OSError("no route"), "failed")],
)
def test_a_failure_to_send_is_counted_and_not_raised(error: OSError, field: str) -> None:
    sender = UdpSender(BrokenSocket(error), [(LOCALHOST, 9)])  # type: ignore[arg-type]
    sender.send(b"x")
    assert getattr(sender.counts, field) == 1
    assert sender.counts.sent == 0


def test_one_of_a_list_that_cannot_be_reached_keeps_nothing_from_the_others() -> None:
    class HalfBrokenSocket:
        sent_to: list[tuple[str, int]] = []

        def sendto(self, _data: bytes, address: tuple[str, int]) -> None:
            if address[1] == 1:
                raise OSError("no route")
            self.sent_to.append(address)

    half_broken = HalfBrokenSocket()
    sender = UdpSender(half_broken, [(LOCALHOST, 1), (LOCALHOST, 2)])  # type: ignore[arg-type]
    sender.send(b"x")
    assert half_broken.sent_to == [(LOCALHOST, 2)]
    assert (sender.counts.sent, sender.counts.failed) == (1, 1)


def test_sending_after_closing_is_counted_as_failed() -> None:
    async def body() -> None:
        sender = await open_sender(Link("udpout", LOCALHOST, free_port()))
        duplex = await open_duplex(Link("udpout", LOCALHOST, free_port()), lambda *_: None)
        for end_point in (sender, duplex):
            end_point.close()
            end_point.send(b"late")
            await asyncio.sleep(0.0)
            end_point.send(b"later")
            assert end_point.counts.failed == 2

    run(body)


def test_a_listening_duplex_names_who_sent_and_sends_to_whom_it_is_told() -> None:
    async def body() -> None:
        heard: list[tuple[bytes, Address | None]] = []
        port = free_port()
        duplex = await open_duplex(Link("udpin", LOCALHOST, port), lambda data, sender: heard.append((data, sender)))
        assert isinstance(duplex, UdpDuplex)
        duplex.send(b"to nobody")
        assert duplex.counts.no_peer == 1
        async with plain_socket() as first, plain_socket() as second:
            for talker in (first, second):
                talker.sendto(b"x", (LOCALHOST, port))
            await until(lambda: len(heard) == 2)
            assert heard == [(b"x", first.getsockname()), (b"x", second.getsockname())]
            duplex.send(b"to nobody still")
            assert duplex.counts.no_peer == 2
            duplex.bind(first.getsockname())
            second.sendto(b"y", (LOCALHOST, port))
            await until(lambda: len(heard) == 3)
            duplex.send(b"hello first")
            assert first.recv(100) == b"hello first"
            with pytest.raises(BlockingIOError):
                second.recv(100)
        duplex.close()

    run(body)


def test_a_flood_from_others_does_not_take_the_place_of_the_bound_peer() -> None:
    async def body() -> None:
        heard: list[bytes] = []
        link = Link("udpin", LOCALHOST, free_port())
        duplex = await open_duplex(link, lambda data, _: heard.append(data), receive_buffer_bytes=4096)
        async with plain_socket() as autopilot, plain_socket() as stranger:
            duplex.bind(autopilot.getsockname())
            for _ in range(500):
                stranger.sendto(b"junk", (LOCALHOST, link.port))
            autopilot.sendto(b"mode changed", (LOCALHOST, link.port))
            await asyncio.sleep(0.0)
            await asyncio.sleep(0.0)
            assert b"mode changed" in heard
            assert duplex.overruns() > 0
        duplex.close()

    run(body)


def test_a_port_with_a_bound_peer_is_still_no_other_programs() -> None:
    async def body() -> None:
        link = Link("udpin", LOCALHOST, free_port())
        duplex = await open_duplex(link, lambda _data, _sender: None)
        async with plain_socket() as autopilot:
            duplex.bind(autopilot.getsockname())
            async with plain_socket() as other:
                rival = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                rival.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                with rival, pytest.raises(OSError, match="in use"):
                    rival.bind((LOCALHOST, link.port))
                duplex.bind(other.getsockname())
                duplex.send(b"to the other")
                assert other.recv(100) == b"to the other"
        duplex.close()

    run(body)


def test_a_calling_duplex_hears_its_peer_and_nobody_else() -> None:
    async def body() -> None:
        heard: list[bytes] = []
        async with plain_socket() as peer, plain_socket() as stranger:
            duplex = await open_duplex(
                Link("udpout", LOCALHOST, peer.getsockname()[1]), lambda data, _: heard.append(data)
            )
            assert isinstance(duplex, UdpDuplex)
            duplex.send(b"hello")
            data, address = peer.recvfrom(100)
            assert data == b"hello"
            stranger.sendto(b"hostile", address)
            peer.sendto(b"reply", address)
            await until(lambda: b"reply" in heard)
            assert heard == [b"reply"]
            duplex.bind(stranger.getsockname())
            assert duplex.peer == peer.getsockname()
            duplex.close()

    run(body)


def test_an_absent_peer_that_comes_up_later_is_heard() -> None:
    async def body() -> None:
        heard: list[bytes] = []
        port = free_port()
        duplex = await open_duplex(Link("udpout", LOCALHOST, port), lambda data, _: heard.append(data))
        for _ in range(5):
            duplex.send(b"anybody?")
            await asyncio.sleep(0.005)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind((LOCALHOST, port))
            late.settimeout(2.0)
            duplex.send(b"now?")
            late.sendto(b"yes", late.recvfrom(100)[1])
            await until(lambda: heard == [b"yes"])
        duplex.close()

    run(body)


def test_a_port_in_use_is_an_error_in_one_line() -> None:
    async def body() -> None:
        async with plain_socket() as owner:
            link = Link("udpin", LOCALHOST, owner.getsockname()[1])
            for opening in (open_receiver(link, lambda _: None), open_duplex(link, lambda *_: None)):
                with pytest.raises(InputError, match=f"link '{link}': port {link.port} is in use"):
                    await opening

    run(body)


def test_two_receivers_never_share_a_port() -> None:
    async def body() -> None:
        link = Link("udpin", LOCALHOST, free_port())
        first = await open_receiver(link, lambda _: None)
        with pytest.raises(InputError, match="is in use"):
            await open_receiver(link, lambda _: None)
        first.close()

    run(body)


def test_an_unknown_host_name_is_an_error_in_one_line() -> None:
    async def body() -> None:
        with pytest.raises(InputError, match="host name 'nowhere.invalid' is unknown"):
            await open_sender(Link("udpout", "nowhere.invalid", 14550))

    run(body)


def test_an_end_point_refuses_the_wrong_direction() -> None:
    async def body() -> None:
        with pytest.raises(InputError, match="only listens; allowed: udpin.*mcast.*serial.*file"):
            await open_receiver(Link("udpout", LOCALHOST, 14550), lambda _: None)
        with pytest.raises(InputError, match="only sends; allowed: udpout.*mcast.*serial.*file"):
            await open_sender(Link("udpin", LOCALHOST, 14550))

    run(body)


@pytest.mark.parametrize(
    "text",
    [
        "udpout:127.0.0.1:1,127.0.0.1:2",
        "udpbcast:127.255.255.255:14550",
        "mcast:239.1.1.1:14550",
        "file:flight.tlog",
    ],
)
def test_an_autopilot_is_not_spoken_with_over_a_link_of_one_direction(text: str) -> None:
    async def body() -> None:
        with pytest.raises(InputError, match="this end goes both ways; allowed: udpin:HOST:PORT, udpout:HOST:PORT"):
            await open_duplex(parse_link(text), lambda *_: None)

    run(body)


def test_every_scheme_has_an_end() -> None:
    assert set(RECEIVING) | set(SENDING) | set(DUPLEX) == set(SCHEMES)
    assert set(SCHEMES) - set(RECEIVING) == {"udpout", "tcp"}
    assert set(SCHEMES) - set(SENDING) == {"udpin", "tcp"}


def test_a_receiver_asks_for_a_larger_buffer_than_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, ...]] = []

    class WatchedSocket(socket.socket):
        def setsockopt(self, *arguments: int) -> None:  # type: ignore[override]
            asked.append(arguments)
            super().setsockopt(*arguments)

    monkeypatch.setattr(socket, "socket", WatchedSocket)

    async def body() -> None:
        port = free_port()
        receiver = await open_receiver(Link("udpin", LOCALHOST, port), lambda _: None)
        receiver.close()

    run(body)
    assert (socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES) in asked
