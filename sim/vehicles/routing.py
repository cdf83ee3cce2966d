"""Which messages an autopilot forwards between its links: a deployment with one radio relies on this rule.

As measured on ArduPilot and PX4 (docs/autopilots.md): a message that the autopilot does not know is dropped; a known
one without a target system goes to every other link, with the sender's ids kept; one for a target system goes only to
the links on which that system was heard. A link on which nothing was ever heard gets nothing. PX4's loss above some 200
messages a second is not modelled.
"""

from __future__ import annotations

from collections.abc import Sequence

from pymavlink.dialects.v20 import common as mavlink

from sim.vehicles.craft import Message

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_NEVER_FORWARDED = frozenset({"RADIO_STATUS"})
"""Messages that stay on their link: a radio's status is for the autopilot it is connected to (read in the source)."""


class Router:
    """Forwards messages between an autopilot's links by the systems and components that were heard on each."""

    def __init__(self, system_id: int) -> None:
        """Route for the autopilot with this MAVLink system id."""
        self._system_id = system_id
        self._routes: dict[tuple[int, int], set[int]] = {}

    def route(self, link: int, messages: Sequence[Message]) -> list[tuple[int, bytes]]:
        """Take parsed messages that came on a link; return the frames to forward, each with the link it leaves on."""
        forwarded: list[tuple[int, bytes]] = []
        for message in messages:
            name = message.get_type()
            if name == "BAD_DATA" or name.startswith("UNKNOWN_"):
                continue
            source = message.get_srcSystem(), message.get_srcComponent()
            if source == (self._system_id, _AUTOPILOT_COMPONENT):
                continue  # a message of this autopilot, returned over a loop of links
            self._routes.setdefault(source, set()).add(link)
            if name in _NEVER_FORWARDED:
                continue
            target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
            frame = bytes(message.get_msgbuf())
            forwarded += [(other, frame) for other in sorted(self._links_for(*target) - {link})]
        return forwarded

    def _links_for(self, system: int, component: int) -> set[int]:
        if (system, component) == (self._system_id, _AUTOPILOT_COMPONENT):
            return set()
        links: set[int] = set()
        for (known_system, known_component), heard_on in self._routes.items():
            if system in (0, known_system) and (system == 0 or component in (0, known_component)):
                links |= heard_on
        return links
