"""From field and mission to paths: rounds, swaths, turns, speeds, detours, and the node that follows progress."""
