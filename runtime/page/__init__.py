"""Operator's page of `headland page`: feeds of a running drive and of a log, and its processes."""
