"""Modes by ArduCopter's custom_mode numbers (ArduCopter/mode.h), which the paper's point borrows."""

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
ARMABLE_MODES = frozenset({STABILIZE, ALT_HOLD, GUIDED, LOITER})
