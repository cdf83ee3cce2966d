"""Which sense of the others a vehicle has, in words."""

from __future__ import annotations

from companion.onboard.config import Config


def without_a_sense(config: Config, others_untold: bool, sees_others: bool | None) -> str | None:
    """Return what is to be said of a vehicle that nothing tells where the others are; None if something does.

    Args:
        config: The configuration.
        others_untold: Whether there are others, and the broadcast tells the place of none of them.
        sees_others: Whether its own detector shows others; None if it is not known whether there is one.

    """
    if config.law != "routed":
        return None
    if config.detector == "none":
        return f"no sense of others is configured: separation_m {config.separation_m:g} is not kept"
    blind = config.detector == "broadcast" or sees_others is False or (sees_others is None and config.case == "I")
    if others_untold and blind:
        return f"no sense of others: separation_m {config.separation_m:g} is not kept"
    return None
