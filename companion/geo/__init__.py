"""Geometry on the mission's plane: the local frame, arcs, turn rates, polygons."""
