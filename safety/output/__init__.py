"""What the supervisor writes: safe command, supervisor state, alarms."""
