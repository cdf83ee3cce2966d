"""Identification: how well one vehicle obeys, measured in a pattern of one to two minutes or read from a flight log."""
