"""The program on the vehicle, and what all three programs share: the wire, the mission file, the guidance law."""
