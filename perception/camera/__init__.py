"""Camera: detector, ground-plane ranging, state of the lens, and the nodes that run them on each picture."""
