"""Files: YAML, state that survives a crash, network weights, and tlogs."""
