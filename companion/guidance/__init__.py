"""From what a vehicle knows to a wanted heading: laws, the route around the discs, separation."""
