"""The simulator: stand-in vehicles, a lossy broadcast link, missions flown in lockstep, and the figures of a flight."""
