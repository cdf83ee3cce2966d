"""The shortest route around discs: the scene, the search in it, reachability, and the router that plans every step."""
