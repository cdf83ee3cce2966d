"""Runs the site: a feed's messages in, HTTP and WebSocket out, until the feed ends or the server is told to stop."""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
import ssl
from pathlib import Path
from typing import Any

import uvicorn
from cryptography import x509

from companion.errors import InputError
from groundstation.web.access import Access
from groundstation.web.address import bound
from groundstation.web.api import Api
from groundstation.web.application import application
from groundstation.web.connection import settings
from groundstation.web.feed import Feed
from groundstation.web.hub import Hub
from groundstation.web.site import Site, check_site

SHUTDOWN_S = 2
"""Time for answers that are under way when the server stops."""
_LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")


async def serve(feed: Feed, site: Site, listener: socket.socket, session_key: bytes | None = None) -> None:
    """Serve a feed until it ends, or SIGINT or SIGTERM comes.

    `session_key` signs the sessions: with the same one they outlive this process.

    Raises:
        InputError: the site is not guarded as its address demands, or one of its files cannot be used.

    """
    check_site(site)
    hub = Hub()
    api = Api(site, hub, feed, Access(site, session_key or secrets.token_bytes(32)))
    app = application(api, hosts_of(site, listener))
    config = uvicorn.Config(app, lifespan="off", timeout_graceful_shutdown=SHUTDOWN_S, **settings(), **_tls(site))
    try:
        config.load()
    except (OSError, ssl.SSLError) as error:
        raise InputError(f"--ui-cert: {site.certificate} with --ui-key: {error.strerror or error}") from error
    # What strangers send wrong is answered; a line for each would let them fill a disk.
    errors = logging.getLogger("uvicorn.error")
    errors.setLevel(logging.ERROR)
    errors.addFilter(_is_error)
    server = uvicorn.Server(config)
    fed = asyncio.create_task(feed.run(hub))
    fed.add_done_callback(lambda _: setattr(server, "should_exit", True))
    reckoned = asyncio.create_task(api.reckoning.run())
    try:
        await server.serve(sockets=[listener])
    finally:
        for task in (fed, reckoned):
            task.cancel()
        await asyncio.gather(fed, reckoned, return_exceptions=True)


def _is_error(record: logging.LogRecord) -> bool:
    """Return whether a message of uvicorn tells of an error: it calls a stream that was refused with a reason one."""
    return record.getMessage() != "ASGI callable returned without completing handshake."


def hosts_of(site: Site, listener: socket.socket) -> list[str]:
    """Return the names and addresses by which the site may be asked for."""
    hosts = [site.address.host, bound(listener).host]
    if site.address.is_loopback:
        hosts += _LOCAL_HOSTS
    if site.certificate is not None:
        hosts += names_in(site.certificate)
    return hosts


def names_in(certificate: Path) -> list[str]:
    """Return the host names and addresses that a certificate is for; raises InputError if it cannot be read."""
    try:
        parsed = x509.load_pem_x509_certificate(certificate.read_bytes())
        names = parsed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except OSError as error:
        raise InputError(f"--ui-cert: {certificate}: {error.strerror}") from error
    except (ValueError, x509.ExtensionNotFound) as error:
        raise InputError(
            f"--ui-cert: {certificate}: no certificate with a subject alternative name; allowed: PEM, with the names "
            "under which browsers reach the page"
        ) from error
    hosts = names.get_values_for_type(x509.DNSName)
    return [*hosts, *(str(address) for address in names.get_values_for_type(x509.IPAddress))]


def _tls(site: Site) -> dict[str, Any]:
    if site.certificate is None:
        return {}
    tls: dict[str, Any] = {"ssl_certfile": str(site.certificate), "ssl_keyfile": str(site.key)}
    if site.client_ca is not None:
        # With tokens as well, whoever has no certificate may still log in.
        wanted = ssl.CERT_REQUIRED if site.tokens is None else ssl.CERT_OPTIONAL
        tls |= {"ssl_ca_certs": str(site.client_ca), "ssl_cert_reqs": wanted}
    return tls
