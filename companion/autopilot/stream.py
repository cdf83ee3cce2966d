"""The gap after which a stream of setpoints counts as ended."""

STREAM_GAP_S = 0.75
"""Time without a setpoint after which a stream counts as ended. Chosen: more than the period of 0.5 s of the slowest
setpoint rate, less than the COM_OF_LOSS_T of 0.8 to 1 s that `companion check` demands."""
