"""The ground station: tracks, target assignment and the one-way broadcast."""
