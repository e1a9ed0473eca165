"""Path following: steering, speed and brake, implement; the supervisor decides on the resulting control command."""
