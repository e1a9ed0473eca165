"""One list of tracks from the obstacles of all sensors."""
