"""In reverse into a bay of the shed, and forward out of it: ways with cusps, kept clear of walls and posts."""
