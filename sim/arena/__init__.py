"""Guidance laws side by side over scenario families drawn from a seed, measured against a planner that knows all."""
