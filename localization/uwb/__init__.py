"""UWB ranges: gating and the tag smoother."""
