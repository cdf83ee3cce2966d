"""The store of the ground station: what was decided, for ever, and what was seen and sent, for as long as it fits."""
