"""Guidance of one vehicle, from its world model to a wanted heading: laws, route around the discs, separation."""
