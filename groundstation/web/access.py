"""Who somebody is that asks, and what that allows: by token, by a session that a token began, or by client certificate.

On the loopback address without tokens everybody on this computer is operator, as everybody at its keyboard is. Beyond
it, TLS and a token or certificate are demanded. A session's cookie holds no secret of the token: it names the token's
hash and its own end, under a key that lives as long as the ground station runs.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Mapping, Sequence
from typing import Any

from companion.errors import printable
from groundstation.web.pipe import Who
from groundstation.web.site import Site
from groundstation.web.tokens import MOST_NAME, TokenFile, hash_of

SESSION_S = 12 * 3600.0
"""Length of a session: a day's flying."""
LOCAL = Who("local", "operator")
"""Everybody on the loopback address where no token is asked for."""
OPERATOR_UNIT = "operator"
"""Organizational unit (OU) of a client certificate that may command; others may look."""
_MOST_COOKIE = 4_096


class Access:
    """Tells who asks, from what a request brings."""

    def __init__(self, site: Site, session_key: bytes) -> None:
        """Guard a site; `session_key` signs its sessions. Raises InputError if the file of tokens cannot be used."""
        self._tokens = None if site.tokens is None else TokenFile(site.tokens)
        self._by_certificate = site.client_ca is not None
        self._key = session_key
        self.cookie = "__Host-groundstation" if site.certificate is not None else f"groundstation-{site.address.port}"
        """Name of the cookie; browsers accept the first only over TLS, and only from this very host."""
        self.is_open = self._tokens is None and not self._by_certificate
        """Whether everybody who reaches the site is operator."""

    def who(self, headers: Mapping[str, str], certificate: Mapping[str, Any] | None, now_s: float) -> Who | None:
        """Return who asks, None if nobody is known; `certificate` is the peer's, which TLS has checked."""
        if self.is_open:
            return LOCAL
        if self._by_certificate and certificate:
            return _subject(certificate)
        scheme, _, token = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self.holder(token.strip())
        return self._session(headers.get("cookie", ""), now_s)

    def holder(self, token: str) -> Who | None:
        """Return whose a token is, None if it is nobody's."""
        found = None if self._tokens is None else self._tokens.find(hash_of(token))
        return None if found is None else found.who

    def begin_session(self, token: str, now_s: float) -> str | None:
        """Return the value of a cookie for a token; None if the token is nobody's."""
        if self.holder(token) is None:
            return None
        content = f"{hash_of(hash_of(token))}.{int(now_s + SESSION_S)}"
        return f"{content}.{self._seal(content)}"

    def _session(self, header: str, now_s: float) -> Who | None:
        content, _, seal = _cookie(header, self.cookie).rpartition(".")
        if self._tokens is None or not hmac.compare_digest(seal.encode(), self._seal(content).encode()):
            return None
        digest, _, end_s = content.partition(".")
        if now_s >= int(end_s):
            return None
        # The token may have been revoked since.
        return next((one.who for one in self._tokens.tokens() if hash_of(one.sha256) == digest), None)

    def _seal(self, content: str) -> str:
        digest = hmac.new(self._key, content.encode(), hashlib.sha256).digest()
        return base64.urlsafe_b64encode(digest).decode().rstrip("=")


def _cookie(header: str, name: str) -> str:
    """Return the value of a cookie in a header of any content, an empty text if there is none."""
    if len(header) > _MOST_COOKIE:
        return ""
    for part in header.split(";"):
        key, _, value = part.strip().partition("=")
        if key == name and value.isascii():
            return value
    return ""


def _subject(certificate: Mapping[str, Any]) -> Who | None:
    """Return who a client certificate is for: its common name, operator if its unit is so called."""
    subject: Sequence[Sequence[tuple[str, str]]] = certificate.get("subject", ())
    pairs = [pair for part in subject for pair in part]
    names = [value for key, value in pairs if key == "commonName"]
    if not names:
        return None
    units = [value for key, value in pairs if key == "organizationalUnitName"]
    return Who(printable(names[0][:MOST_NAME]), "operator" if OPERATOR_UNIT in units else "observer")
