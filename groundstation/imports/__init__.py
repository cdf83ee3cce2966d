"""Missions from files of other programs: QGroundControl's plans, KML and GeoJSON."""
