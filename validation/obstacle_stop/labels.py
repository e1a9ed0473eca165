"""What the decisions of a person on proposed objects leave open: reasons why a log is not shown."""

from typing import Any

from datasets.importers.sidecar_lines import Sidecar, Status
from validation.obstacle_stop.observation import LogObservation

NAMED = 5
NOT_PERCEIVED = (
    "the truth lists only what was perceived: missed objects are not shown "
    "(review the log, add what is missing, then: headland label LOG --complete)"
)


def open_questions(sidecar: Sidecar, observed: LogObservation) -> dict[str, Any]:
    """Values of the log: `not_shown` reasons, whether the truth is complete, and the ids of rejected objects."""
    undecided = [o for o in sidecar.objects if o.status is Status.PROPOSED]
    names = [
        f"{o.id} ({o.label.value}, {observed.time_s(o.first_ns):.1f} to {observed.time_s(o.last_ns):.1f} s)"
        for o in undecided[:NAMED]
    ]
    more = f" and {len(undecided) - NAMED} more" if len(undecided) > NAMED else ""
    reasons = [f"undecided proposed objects: {', '.join(names)}{more}"] if undecided else []
    reasons += [] if sidecar.is_complete else [NOT_PERCEIVED]
    rejected = [o.id for o in sidecar.objects if o.status is Status.REJECTED]
    return {"not_shown": reasons, "is_truth_complete": sidecar.is_complete, "rejected": rejected}
