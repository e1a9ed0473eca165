"""Statistics: worked area, time, distance and stops by day and field, kept in SQLite."""
