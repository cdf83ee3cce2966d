"""A look at a mission at the desk: where everything is, what is doubtful about it, and a picture."""
