"""Executor, bus, assembly and command line: what runs the nodes; imported by nobody."""
