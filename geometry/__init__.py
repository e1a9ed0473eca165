"""Transforms, angles, geodesy, polylines, polygons and the swept footprint: pure functions on arrays."""
