"""Step of one node, in the process of the executor or in one of its own."""

import traceback

from messages.errors import WiringError
from messages.node import Node, Output
from runtime.bus import NodeInbox

StepResult = list[Output] | str  # outputs, or the traceback of the exception


def step_node(node: Node, now_ns: int, inbox: NodeInbox) -> StepResult:
    """Outputs of a step, or the traceback of its exception; an undeclared output is one."""
    inbox.now_ns = now_ns
    try:
        outputs = list(node.step(now_ns, inbox))
        for topic, _ in outputs:
            if topic not in node.writes:
                raise WiringError(f"node {node.name!r} writes {topic!r}, which it does not declare")
        return outputs
    except Exception:  # any failure of a node leads to a stop, not to a crash
        return traceback.format_exc()
    finally:
        inbox.clear()
