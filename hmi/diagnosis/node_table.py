"""Latencies of the nodes of a live machine over their last second."""

from typing import Any

from hmi.drive_view.row import number
from hmi.page_state import PageState
from messages.timing import NodeTiming


def node_rows(state: PageState) -> list[list[Any]]:
    """Rows of a table, slowest first: node, steps, mean and longest latency; none for a simulation in one process."""
    found = [(topic.partition("/")[2], state.newest(topic, NodeTiming)) for topic in state.topics("node_timing")]
    timings = sorted(((name, one) for name, one in found if one is not None), key=lambda entry: -entry[1].longest_s)
    return [
        [name, str(one.steps), number(1e3 * one.mean_s, 1, "ms"), number(1e3 * one.longest_s, 1, "ms")]
        for name, one in timings
    ]
