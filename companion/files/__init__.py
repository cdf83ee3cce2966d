"""File formats: YAML, state that survives a crash, network weights, tlogs, and the layout of the frames in them."""
