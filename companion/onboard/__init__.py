"""The vehicle's program: what `companion run`, `check` and `replay` are made of."""
