"""Guidance lines: line 0 as the user gives it, line N by the working width to either side (T14-5.4.1)."""
