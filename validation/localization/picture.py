"""Picture of a localized recording, as PNG."""

import io

import numpy as np

from geometry.arrays import Float64, Int64
from validation.localization.judgement import Errors
from validation.localization.trajectory import Trajectory
from validation.localization.truth import Truth

LINE, TRUE, FIX, LEVEL = "#1565c0", "#2f7d32", "#b0bec5", "#ffb300"


def draw(trajectory: Trajectory, fixes: tuple[Int64, Float64], truth: Truth | None, errors: Errors | None) -> bytes:
    """Track over fixes and truth, and error below protection level over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (track, time) = pyplot.subplots(2, 1, figsize=(11, 11), height_ratios=[2, 1], layout="constrained")
    track.plot(*fixes[1].T, ".", color=FIX, ms=4, label="fixes")
    if truth is not None and truth.is_placed:
        track.plot(*truth.p_m.T, color=TRUE, lw=2.0, label="truth")
    for part in trajectory.parts:
        label = "localizer" if part.start == 0 else None
        track.plot(*trajectory.T_map_base[part, :2, 3].T, color=LINE, lw=1.0, label=label)
    track.set_aspect("equal", "datalim")
    track.set(xlabel="east (m)", ylabel="north (m)")
    track.legend()
    begin_ns = int(trajectory.stamps_ns[0]) if len(trajectory) else 0
    t_s, level_m = (trajectory.stamps_ns - begin_ns) * 1e-9, trajectory.level_m
    time.plot(t_s, np.where(np.isfinite(level_m), level_m, np.nan), ".", color=LEVEL, ms=2, label="protection level")
    if errors is not None:
        time.plot((errors.stamps_ns - begin_ns) * 1e-9, errors.distance_m, ".", color=LINE, ms=2, label="error")
    time.set(xlabel="time since the first position (s)", ylabel="m", ylim=(0.0, None))
    time.legend()
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    pyplot.close(figure)
    return out.getvalue()
