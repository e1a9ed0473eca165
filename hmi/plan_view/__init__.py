"""Plan view: a field from a file or drawn, planned by the planner in a process of its own, and stored missions."""
