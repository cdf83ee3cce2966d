"""The shortest way around discs: the scene, the search in it, what can be reached at all, and the router."""
