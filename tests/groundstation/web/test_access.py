"""Who may do what: on the loopback address, by token, by session and by client certificate."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from companion.errors import InputError
from groundstation.web.access import LOCAL, SESSION_S, Access
from groundstation.web.address import Address, listen, parse_address
from groundstation.web.pipe import Who
from groundstation.web.site import Site, check_site, site_from, site_to_dict
from groundstation.web.tokens import add_token, read_tokens, revoke_token
from tests.groundstation.web.web_site import Served, why

KEY = b"k" * 32
ANNA = Who("anna", "operator")
BEN = Who("ben", "observer")


class Guarded:
    """A site with a file of tokens, and a token of each role."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tokens.json"
        self.anna, self.ben = add_token(self.path, ANNA), add_token(self.path, BEN)
        self.site = Site(tokens=self.path)
        self.access = Access(self.site, KEY)
        self.served = Served(self.site)

    def cookie(self, value: str) -> dict[str, str]:
        return {"cookie": f"other=1; {self.access.cookie}={value}; x"}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Guarded:
    return Guarded(tmp_path_factory.mktemp("web"))


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


def test_on_the_loopback_address_without_tokens_everybody_is_operator() -> None:
    assert Access(Site(), KEY).who({}, None, 0.0) == LOCAL


def test_a_token_tells_who_asks_and_nothing_else_does(guarded: Guarded) -> None:
    who = guarded.access.who
    assert who(bearer(guarded.anna), None, 0.0) == ANNA
    assert who(bearer(guarded.ben), None, 0.0) == BEN
    for headers in ({}, bearer(""), bearer("gs_" + "A" * 43), {"authorization": guarded.anna}, bearer("\udcff")):
        assert who(headers, None, 0.0) is None


def test_a_session_is_whose_token_began_it_until_its_end(guarded: Guarded) -> None:
    value = guarded.access.begin_session(guarded.ben, 1_000.0)
    assert value is not None
    assert guarded.access.who(guarded.cookie(value), None, 1_000.0 + SESSION_S - 1.0) == BEN
    assert guarded.access.who(guarded.cookie(value), None, 1_000.0 + SESSION_S) is None
    assert guarded.ben not in value
    assert guarded.access.begin_session("nobody's", 0.0) is None


@pytest.mark.parametrize("junk", ["", ".", "..", "a.b.c", "a" * 5_000, "\xff.1.x", "x.99999999999.AAAA"])
def test_a_cookie_that_was_not_made_here_lets_nobody_in(guarded: Guarded, junk: str) -> None:
    assert guarded.access.who(guarded.cookie(junk), None, 0.0) is None


def test_a_cookie_with_another_end_or_of_another_run_lets_nobody_in(guarded: Guarded) -> None:
    value = guarded.access.begin_session(guarded.anna, 0.0)
    assert value is not None
    digest, end_s, seal = value.split(".")
    assert guarded.access.who(guarded.cookie(f"{digest}.{int(end_s) + 9}.{seal}"), None, 0.0) is None
    assert Access(guarded.site, b"x" * 32).who(guarded.cookie(value), None, 0.0) is None


def test_a_token_that_is_revoked_ends_its_sessions_at_once(tmp_path: Path) -> None:
    one = Guarded(tmp_path)
    value = one.access.begin_session(one.anna, 0.0)
    assert value is not None
    revoke_token(one.path, "anna")
    assert one.access.who(bearer(one.anna), None, 0.0) is None
    assert one.access.who(one.cookie(value), None, 0.0) is None
    assert one.access.who(bearer(one.ben), None, 0.0) == BEN


def test_a_client_certificate_tells_who_asks_and_its_unit_what_that_allows() -> None:
    access = Access(Site(client_ca=Path("ca.pem")), KEY)
    subject = ((("organizationalUnitName", "operator"),), (("commonName", "anna"),))
    assert access.who({}, {"subject": subject}, 0.0) == ANNA
    assert access.who({}, {"subject": subject[1:]}, 0.0) == Who("anna", "observer")
    assert access.who({}, {"subject": ()}, 0.0) is None
    assert access.who({}, None, 0.0) is None


def test_an_observer_sees_everything_and_changes_nothing(guarded: Guarded) -> None:
    served = guarded.served
    served.reset()
    served.hub.message({"type": "picture", "t_s": 1.0})
    headers = bearer(guarded.ben)
    assert served.ask("GET", "/api/v1/picture", headers=headers).status_code == 200
    for method, path, body in CHANGES:
        answer = served.ask(method, path, body, headers)
        assert answer.status_code == 403, path
        assert why(answer) == "ben is observer; allowed: for an operator only"
    assert served.feed.commands == []


CHANGES = [
    ("POST", "/api/v1/commands", {"do": "pause"}),
    ("POST", "/api/v1/targets", {"north_m": 1, "east_m": 1}),
    ("POST", "/api/v1/threats", {"north_m": 1, "east_m": 1, "radius_m": 1}),
    ("PATCH", "/api/v1/targets/1", {"name": "x"}),
    ("PATCH", "/api/v1/threats/1", {"name": "x"}),
    ("DELETE", "/api/v1/targets/1", None),
    ("DELETE", "/api/v1/threats/1", None),
]


def test_who_has_no_token_sees_nothing_and_changes_nothing(guarded: Guarded) -> None:
    served = guarded.served
    served.reset()
    served.hub.message({"type": "picture", "t_s": 1.0})
    reads = ["picture", "sources", "events", "routes", "trails", "why/1", "session"]
    for method, path, body in [*CHANGES, *(("GET", f"/api/v1/{name}", None) for name in reads)]:
        answer = served.ask(method, path, body)
        assert answer.status_code == 401, path
        assert why(answer)
    assert served.feed.commands == []


def test_logging_in_sets_a_cookie_that_scripts_and_other_sites_cannot_use(guarded: Guarded) -> None:
    served = guarded.served
    served.reset()
    answer = served.ask("POST", "/api/v1/session", {"token": guarded.anna})
    assert answer.json() == {"name": "anna", "role": "operator", "login": True, "mode": "live", "tiles": False}
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert guarded.anna not in cookie
    given = {"cookie": cookie.partition(";")[0]}
    assert served.ask("GET", "/api/v1/session", headers=given).json()["name"] == "anna"
    assert served.ask("POST", "/api/v1/session", {"token": "wrong"}).status_code == 401


def test_what_a_command_became_names_whose_token_gave_it(guarded: Guarded) -> None:
    guarded.served.reset()
    answer = guarded.served.ask("POST", "/api/v1/commands", {"do": "pause"}, bearer(guarded.anna))
    assert answer.json()["who"] == {"name": "anna", "role": "operator"}


def test_the_file_of_tokens_holds_hashes_for_its_owner_only(guarded: Guarded) -> None:
    assert stat.S_IMODE(guarded.path.stat().st_mode) == 0o600
    text = guarded.path.read_text()
    assert guarded.anna not in text
    assert [token.who for token in read_tokens(guarded.path)] == [ANNA, BEN]


@pytest.mark.parametrize(
    "who",
    [Who("anna", "operator"), Who("", "observer"), Who("x" * 41, "observer"), Who("c", "king"), Who("\n", "observer")],
)
def test_a_token_for_a_name_that_is_taken_or_unfit_is_refused(guarded: Guarded, who: Who) -> None:
    with pytest.raises(InputError, match="allowed"):
        add_token(guarded.path, who)


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"tokens": [{"name": "a", "role": "king", "sha256": "x"}]}', "\xff"]
)
def test_a_file_that_holds_no_tokens_is_refused_in_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "tokens.json"
    path.write_text(content)
    path.chmod(0o600)
    with pytest.raises(InputError, match="no file of tokens"):
        Access(Site(tokens=path), KEY)
    path.chmod(0o666)
    with pytest.raises(InputError, match="others can write"):
        read_tokens(path)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::", "ground.example"])
def test_beyond_loopback_tls_and_a_token_or_certificate_are_demanded(host: str, tmp_path: Path) -> None:
    there = tmp_path / "file"
    there.touch()
    address = Address(host, 8750)
    with pytest.raises(InputError, match="without TLS"):
        check_site(Site(address, tokens=there))
    with pytest.raises(InputError, match="by anybody"):
        check_site(Site(address, certificate=there, key=there))
    check_site(Site(address, certificate=there, key=there, tokens=there))
    check_site(Site(address, certificate=there, key=there, client_ca=there))


def test_half_of_what_tls_needs_or_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    there = tmp_path / "file"
    there.touch()
    for site in (Site(certificate=there), Site(key=there), Site(client_ca=there), Site(tokens=tmp_path / "none")):
        with pytest.raises(InputError, match="--ui-.*allowed"):
            check_site(site)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:1", ("127.0.0.1", 1)),
        (":99", ("127.0.0.1", 99)),
        ("localhost", ("localhost", 8750)),
        ("[::1]:7", ("::1", 7)),
        ("::1", ("::1", 8750)),
    ],
)
def test_an_address_is_read_in_every_form(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address
    assert parse_address(str(parse_address(text))) == address
    assert parse_address(text).is_loopback


@pytest.mark.parametrize("text", ["a:b", "1.2.3.4:70000", "http://x:1", "a b:1", "x:-1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--ui: .*allowed: "):
        parse_address(text)


def test_a_port_that_is_taken_is_refused_at_once() -> None:
    with listen(Address("127.0.0.1", 0)) as taken:
        with pytest.raises(InputError, match="in use"):
            listen(Address(*taken.getsockname()))


def test_a_site_is_told_to_the_web_process_whole() -> None:
    site = Site(Address("::1", 5), "sim", Path("t"), Path("c"), Path("k"), Path("a"), Path("m"), "json")
    assert site_from(site_to_dict(site)) == site
