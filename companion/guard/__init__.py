"""The guard: the last thing a setpoint passes. Imports numpy and the standard library only."""
