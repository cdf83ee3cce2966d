"""Autopilots: their kinds, telemetry, parameters, commands and setpoints, one module per kind."""
