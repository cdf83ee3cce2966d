"""When a stream of setpoints counts as ended."""

STREAM_GAP_S = 0.75
"""A stream with a longer gap has ended, as PX4 sees it soon. Chosen: more than the slowest setpoint rate's period of
0.5 s, less than the COM_OF_LOSS_T of 1 s that `companion check` asks for."""
