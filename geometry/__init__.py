"""Geometry: transforms, angles, geodesy, polylines, polygons and footprints as pure functions on arrays."""
