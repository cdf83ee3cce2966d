"""Warnings before a flight about a mission that depend on how its vehicles fly: law, guard and right of way."""
