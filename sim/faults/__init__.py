"""Faults: one vehicle in flight, what can go wrong with it, and what then happens."""
