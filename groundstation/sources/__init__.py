"""Live sources of sightings: parsers, links, the association of what they say, and their health."""
