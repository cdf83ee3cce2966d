"""What the web process is told of the site that it serves: who may come in, and from where."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from groundstation.web.address import Address

Mode = Literal["live", "sim", "playback"]
"""What is shown: a ground station on the air, a simulated flight, or a recorded one."""


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
    log_format: Literal["text", "json"] = "text"

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "http" if self.certificate is None else "https"

    @property
    def url(self) -> str:
        """The address as a browser is given it."""
        return f"{self.scheme}://{self.address}/"


def site_to_dict(site: Site) -> dict[str, Any]:
    """Return a site as JSON values."""
    values = asdict(site)
    values["address"] = list(site.address)
    return {key: str(value) if isinstance(value, Path) else value for key, value in values.items()}


def site_from(values: dict[str, Any]) -> Site:
    """Return the site that `site_to_dict` wrote."""
    paths = {key: None if values[key] is None else Path(values[key]) for key in _PATHS}
    return Site(Address(*values["address"]), values["mode"], log_format=values["log_format"], **paths)


_PATHS = ("tokens", "certificate", "key", "client_ca", "tiles")
