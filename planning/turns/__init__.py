"""Connections between path sections: Dubins curves, turns, headland transit."""
