"""One small module per autopilot kind: telemetry in, setpoint out."""
