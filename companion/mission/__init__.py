"""The mission file: its model, what is drawn from a seed, and what is doubtful about it."""
