"""`headland localize`: the localizer over a recording; trajectory, error, protection level, availability."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.run_folder import RunFolder, command_of, named_errors, resolved, versions

if TYPE_CHECKING:
    from runtime.localize.drive import Localized
    from runtime.localize.sources import Sources
    from validation.localization.judgement import Errors
    from validation.localization.truth import Truth

PASSED, FAILED, NOT_SHOWN = 0, 1, 3


def main(arguments: argparse.Namespace) -> int:
    """Localizes and writes the results: 0 placed as required and never off by more than the protection level, 1 not.

    3 where the recording shows no position; raises LogError or ConfigError before anything is written.
    """
    with RunFolder("localize", arguments.out, command_of(arguments)) as folder:
        # only now: these imports take seconds, and a wrong argument is reported at once
        from configs.strict import CONFIGS, load
        from datasets.importers.formats import open_recording
        from runtime.localize.config import LocalizeConfig
        from runtime.localize.drive import localize
        from runtime.localize.sources import sources_of
        from runtime.stack import load_stack
        from validation.localization.truth import of_fixes, read_truth

        own, stack = load(LocalizeConfig, CONFIGS / "localize.yaml"), load_stack()
        recording = open_recording(arguments.log)
        is_own = recording.description.format == "headland"
        config = stack.localization if is_own else own.of(stack.localization)
        sources = sources_of(recording, arguments.vehicle, config.map_alignment.gnss.sensor)
        latency_ns = stack.executor.latency_ns("localizer")
        run, withheld = localize(sources, config, latency_ns, arguments.fixes_every)
        truth = None if arguments.truth is None else read_truth(arguments.truth, run.datum)
        if truth is None and withheld:
            truth = of_fixes("fixes that were withheld", withheld, run.datum)
        result, state = _write(folder, run, sources, truth, own.least_placed_share)
        sections = {"localization": config, "vehicle": sources.vehicle}
        with named_errors(folder.path):
            folder.file("config.yaml").write_text(resolved(**sections), encoding="utf-8")
            folder.file("result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        folder.record("conditions", versions())
        folder.record("result", {"result": result})
        folder.finish()
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _text(result))
    return state


def _write(
    folder: RunFolder, run: "Localized", sources: "Sources", truth: "Truth | None", least_share: float
) -> tuple[dict[str, Any], int]:
    """Writes trajectory and picture; result and exit code."""
    import numpy as np

    from validation.localization.judgement import errors_of
    from validation.localization.picture import draw
    from validation.localization.trajectory import geojson, tum

    trajectory = run.trajectory
    antenna_m = np.array(sources.vehicle.sensors.gnss[sources.gnss.partition("/")[2]].mount.xyz_m)
    errors = None if truth is None else errors_of(trajectory, truth, antenna_m)
    result, state = _result(run, sources, truth, errors, least_share)
    result["run_dir"] = str(folder.path)
    if len(trajectory):
        with named_errors(folder.path):
            folder.file("trajectory.tum").write_text(tum(trajectory, run.datum), encoding="ascii")
            folder.file("trajectory.geojson").write_text(geojson(trajectory, run.datum), encoding="utf-8")
            folder.file("picture.png").write_bytes(draw(trajectory, run.fixes, truth, errors))
    return result, state


def _result(
    run: "Localized", sources: "Sources", truth: "Truth | None", errors: "Errors | None", least_share: float
) -> tuple[dict[str, Any], int]:
    import numpy as np

    from validation.localization.judgement import error_result, fix_errors, statistics

    trajectory, share = run.trajectory, run.placed_after_alignment
    receiver_m = np.zeros(0) if truth is None else fix_errors(*run.fixes, truth)
    first_s = None if run.placed_first_ns is None else round((run.placed_first_ns - (run.first_ns or 0)) * 1e-9, 2)
    about = sources.recording.description
    loop_m = None
    if run.origin_m is not None and len(trajectory):
        loop_m = round(float(np.linalg.norm(trajectory.T_map_base[-1, :2, 3] - run.origin_m)), 3)
    clocks = run.clocks.notes()
    finding = "" if run.wheels is None else run.wheels.finding()
    state, reason = PASSED, ""
    if share is None:
        awaited = ", ".join(run.awaited_s) or run.node.awaited
        state, reason = NOT_SHOWN, f"no position: {'; '.join(filter(None, [*clocks, finding])) or f'awaited {awaited}'}"
    elif finding:
        state, reason = FAILED, finding
    elif share < least_share:
        state, reason = FAILED, f"placed {share:.1%} of the time after the alignment, {least_share:.0%} are required"
    elif errors is not None and errors.exceeded_share > 0.0:
        state, reason = FAILED, f"error above the protection level in {errors.exceeded_share:.2%} of the positions"
    result = {
        "log": str(sources.recording.path), "format": about.format, "vehicle": sources.vehicle.name,
        "state": {PASSED: "passed", FAILED: "failed", NOT_SHOWN: "not_shown"}[state], "reason": reason,
        "span_s": round(run.span_s, 2), "placed_s": round(run.placed_s, 2), "first_position_s": first_s,
        "placed_after_alignment": None if share is None else round(share, 4),
        "awaited_s": {name: round(s, 2) for name, s in sorted(run.awaited_s.items(), key=lambda item: -item[1])},
        "path_m": round(run.path_m, 1), "start_to_end_m": loop_m,
        "protection_level_m": _levels(trajectory.level_m), "accuracy_95_m": _levels(trajectory.accuracy_m),
        "sources": {s: trajectory.sources.count(s) for s in sorted(set(trajectory.sources))},
        "fixes": run.fix_counts, "truth": None if truth is None else truth.source, "error": error_result(errors),
        "receiver_error": statistics(receiver_m) if len(receiver_m) else None,
        "faults": dict(run.faults.most_common()), "samples_dropped": run.node.dropped,
        "notes": [*about.notes, *sources.notes, *clocks, *run.notes],
    }  # fmt: skip
    return result, state


def _levels(values_m: Any) -> dict[str, float | None] | None:
    import numpy as np

    if not len(values_m):
        return None
    last = float(values_m[-1])
    known = values_m[np.isfinite(values_m)]
    named = (("median_m", 50), ("p95_m", 95), ("max_m", 100))
    found = {name: round(float(np.percentile(known, q)), 3) if len(known) else None for name, q in named}
    return found | {"last_m": round(last, 3) if np.isfinite(last) else None}


def _text(result: dict[str, Any]) -> str:
    """The result for the console."""
    lines = [f"{result['format']}, {result['span_s']:.1f} s: {result['state']}"]
    if result["reason"]:
        lines[0] += f" ({result['reason']})"
    if result["placed_after_alignment"] is not None:
        lines.append(
            f"  first position after {result['first_position_s']:.1f} s, then placed "
            f"{result['placed_after_alignment']:.1%} of the time"
        )
    lines += [f"  awaited {name}: {seconds:.1f} s" for name, seconds in result["awaited_s"].items()]
    if (level := result["protection_level_m"]) is not None:
        lines.append(f"  protection level: median {level['median_m']} m, largest {level['max_m']} m")
    for name, text in (("error", "error"), ("receiver_error", "error of the receiver")):
        if (error := result[name]) is not None:
            nees = f", NEES {error['nees']}" if "nees" in error else ""
            lines.append(
                f"  {text}: median {error['median_m']} m, RMSE {error['rmse_m']} m, 95 % {error['p95_m']} m, "
                f"largest {error['max_m']} m (n = {error['n']}){nees}"
            )
    lines += [f"  note: {note}" for note in result["notes"]]
    return "\n".join([*lines, str(Path(result["run_dir"]))]) + "\n"
