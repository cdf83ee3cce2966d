"""What the web process is told of the site that it serves: who may come in, and from where."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from companion.errors import InputError
from groundstation.web.address import Address

Mode = Literal["live", "sim", "playback"]
"""What is shown: a ground station on the air, a simulated flight, or a recorded one."""
LogFormat = Literal["text", "json"]
"""Form of the messages on the terminal: words, or one JSON object a line."""
_FORMS = {
    "--ui-tokens": "a file that `groundstation token` has written",
    "--ui-cert": "a certificate, PEM",
    "--ui-key": "its private key, PEM",
    "--ui-client-ca": "a certificate, PEM",
}
_PATHS = ("tokens", "certificate", "key", "client_ca", "tiles")


@dataclass(frozen=True)
class Site:
    """The site: its address, the files that guard it, and what it shows. No key of the broadcast is among them."""

    address: Address = Address()
    mode: Mode = "live"
    tokens: Path | None = None
    """File of hashed tokens, which `groundstation token` writes; None: everybody who reaches the site is operator."""
    certificate: Path | None = None
    """Certificate of the site, PEM; None: no TLS."""
    key: Path | None = None
    """Private key of that certificate, PEM."""
    client_ca: Path | None = None
    """Authority whose client certificates are let in, PEM."""
    tiles: Path | None = None
    """Folder of map tiles, Z/X/Y.png."""
    log_format: LogFormat = "text"

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "http" if self.certificate is None else "https"

    @property
    def url(self) -> str:
        """The address as a browser is given it."""
        return f"{self.scheme}://{self.address}/"


def check_site(site: Site) -> None:
    """Raise InputError unless a site is guarded as its address demands."""
    if (site.certificate is None) != (site.key is None):
        given, missing = ("--ui-cert", "--ui-key") if site.key is None else ("--ui-key", "--ui-cert")
        raise InputError(f"{given}: given without {missing}; allowed: both, or neither")
    if site.client_ca is not None and site.certificate is None:
        raise InputError("--ui-client-ca: given without --ui-cert; allowed: with --ui-cert and --ui-key")
    for option, path in zip(_FORMS, (site.tokens, site.certificate, site.key, site.client_ca), strict=True):
        if path is not None and not path.is_file():
            raise InputError(f"{option}: '{path}': no such file; allowed: {_FORMS[option]}")
    if site.tiles is not None and not site.tiles.is_dir():
        raise InputError(f"--ui-tiles: '{site.tiles}': no such folder; allowed: one with Z/X/Y.png in it")
    if site.address.is_loopback:
        return
    if site.certificate is None:
        raise InputError(
            f"--ui: '{site.address}' can be reached from other computers, without TLS; allowed: --ui-cert and --ui-key "
            "with it, or an address of this computer only, such as 127.0.0.1:8750"
        )
    if site.tokens is None and site.client_ca is None:
        raise InputError(
            f"--ui: '{site.address}' can be reached from other computers, by anybody; allowed: --ui-tokens or "
            "--ui-client-ca with it, or an address of this computer only, such as 127.0.0.1:8750"
        )


def site_to_dict(site: Site) -> dict[str, Any]:
    """Return a site as JSON values."""
    values = asdict(site)
    values["address"] = list(site.address)
    return {key: str(value) if isinstance(value, Path) else value for key, value in values.items()}


def site_from(values: dict[str, Any]) -> Site:
    """Return the site that `site_to_dict` wrote."""
    paths = {key: None if values[key] is None else Path(values[key]) for key in _PATHS}
    return Site(Address(*values["address"]), values["mode"], log_format=values["log_format"], **paths)
