"""The ground station's page and API: a process of its own, which is shown what the ground station knows."""
