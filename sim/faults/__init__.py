"""Fault injection: one vehicle in flight, the faults of it and of its surroundings, and what each leads to."""
