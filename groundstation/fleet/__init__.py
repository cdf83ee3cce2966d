"""The fleet file, and the configuration of each vehicle that follows from it and the mission."""
