"""The authenticator's trust settings, made from a vehicle's configuration and its key files."""

from __future__ import annotations

from pathlib import Path

from companion.onboard.config import BroadcastSection
from companion.protocol.authenticator import Trust
from companion.protocol.keys import load_mavlink_key, load_public


def trust_of(section: BroadcastSection) -> Trust:
    """Return the trust settings of a configuration, with the keys read from their files.

    Raises:
        InputError: a key file is missing, is not a key, or can be read by other users.

    """
    return Trust(
        mavlink_key=None if section.mavlink_key is None else load_mavlink_key(Path(section.mavlink_key)),
        public_key=None if section.public_key is None else load_public(Path(section.public_key)),
        max_age_s=section.max_age_s,
        ahead_s=section.ahead_s,
        checks_per_s=section.checks_per_s,
        clock_checked=section.clock == "checked",
    )
