"""What a vehicle was told to do: by the directive for all agents and by its own, of which the stronger is obeyed.

Also whether the ground station has said that it stops. That changes nothing by itself: the vehicle does as after any
loss of the broadcast, by the age of its picture; but whoever looks at it knows at once that nothing is broken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.protocol.codec import Directive, FleetFrame, StateFrame


@dataclass(frozen=True)
class Directives:
    """The newest word for all agents and the newest one for this vehicle alone."""

    for_all: Directive = Directive.NORMAL
    own: Directive = Directive.NORMAL
    has_ended: bool = False
    """Whether the newest broadcast said that it is the last."""

    @property
    def ended(self) -> str | None:
        """That the ground station has stopped, in words; None if it did not say so."""
        return "the ground station has stopped" if self.has_ended else None

    @property
    def in_force(self) -> Directive:
        """The stronger of the two."""
        return max(self.for_all, self.own)

    @property
    def words(self) -> str:
        """The directive in force in words, and whether it is for this vehicle alone."""
        words = f"directive {self.in_force.name.lower()}"
        return f"{words}, for this agent" if self.own > self.for_all else words

    def after(self, frame: StateFrame | FleetFrame, agent_id: int) -> Directives:
        """Return what holds after a newer frame, which tells of the vehicle's own directive where it names the agent.

        One of a broadcast's frames names it. What it was told before stands until then, also after a restart of the
        ground station: who was called back keeps coming while only frames about others are heard.
        """
        own = next((agent.directive for agent in frame.agents if agent.id == agent_id), self.own)
        return Directives(frame.directive, own, frame.is_last)

    def unnamed(self) -> Directives:
        """Return what holds after a whole broadcast that does not name the agent."""
        return replace(self, own=Directive.NORMAL)
