"""From field and mission to paths: headland passes, swaths, turns, speeds, detours, docking, and the mission node."""
