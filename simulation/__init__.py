"""The simulated world: machine, terrain, actors and sensors; driven only by frames on the CAN bus."""
