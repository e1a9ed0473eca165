"""Plans as files: GeoJSON, KML and ISOXML task data."""
