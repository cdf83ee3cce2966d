"""ArduCopter's modes by custom_mode number (ArduCopter/mode.h); the paper's point has the same ones."""

from __future__ import annotations

STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 2, 4, 5, 6, 9, 17
COPTER_MODES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    LAND: "LAND",
    BRAKE: "BRAKE",
}
STICK_MODES = frozenset({STABILIZE, ALT_HOLD, LOITER})
"""Modes that are flown by the pilot's sticks."""
ARMABLE_MODES = frozenset({STABILIZE, ALT_HOLD, GUIDED, LOITER})
"""Modes in which the vehicle can be armed."""
