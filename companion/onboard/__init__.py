"""The vehicle's program: the code of `companion run`, `companion check` and `companion replay`."""
