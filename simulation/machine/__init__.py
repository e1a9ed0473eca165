"""The simulated machine: body, drivetrain, steering, implement and its bus."""
