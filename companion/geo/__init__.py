"""Geometry on the mission's plane: local frame, arcs, turn rates and polygons."""
