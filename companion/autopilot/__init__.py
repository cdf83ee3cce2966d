"""The interface to the autopilot: kinds, telemetry, parameters, commands and setpoints, with one adapter per kind."""
