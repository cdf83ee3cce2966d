"""The mission file: its model, the drawing of what it leaves to chance, and warnings about doubtful missions."""
