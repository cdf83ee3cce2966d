"""The guard, the last check of every setpoint before it is sent; imports numpy and the standard library only."""
