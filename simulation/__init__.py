"""The simulated world: machine, terrain, objects and sensors; it obeys frames on the bus and nothing else."""
