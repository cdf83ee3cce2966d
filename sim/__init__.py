"""The stand-in world: a kinematic autopilot, a lossy link, a lockstep runner and its figures."""
