"""Campaign of hazards: many short drives, each with one object, judged by truth."""
