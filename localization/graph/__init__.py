"""The fixed-lag factor graph: keyframes, factors, smoother."""
