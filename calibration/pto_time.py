"""Run-down of the PTO: from the command to switch it off until its shaft hardly turns."""

import numpy as np

from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, plot_of
from configs.vehicle import MountedImplement, TrailedImplement
from geometry.arrays import Float64

STANDS_RADPS = 0.5  # 5 rpm
RUNS_RADPS = 20.0  # of a shaft from whose run-down the time is taken
WAIT_S = 30.0  # for the run-down after a command
MIN_STOPS = 2
LEAST_S = 0.03  # standard deviation: commands are sent every 0.1 s
REPEATS_S = 0.1  # standard deviation of a run-down that repeats


def pto_time(recording: Recording, implement: MountedImplement | TrailedImplement) -> CalibrationResult:
    """Longest of the run-downs (s), with their scatter; raises NotEnough."""
    stops = _stops(recording)
    if len(stops) < MIN_STOPS:
        raise NotEnough("pto_stops", float(len(stops)), float(MIN_STOPS))
    times = np.array([time_s for _, time_s in stops])
    sigma = max(float(np.std(times, ddof=1)), LEAST_S)
    estimate = Estimate("implement.pto_stop_s", float(times.max()), sigma, implement.pto_stop_s)
    at, time_s = stops[int(times.argmax())]
    machine = recording.machine
    shown = machine[(machine[:, 0] >= at - 1.0) & (machine[:, 0] <= at + 1.5 * time_s + 1.0)]
    fastest = float(shown[:, 2].max())
    plot = plot_of("since_command", "pto", shown[:, 0] - at, shown[:, 2], [(time_s, 0.0), (time_s, fastest)])
    return CalibrationResult((estimate,), float(np.ptp(times)) / REPEATS_S, plot)


def _stops(recording: Recording) -> list[tuple[float, float]]:
    """Time of the command and duration of each complete run-down."""
    command, machine, found = recording.command, recording.machine, []
    for at in command[np.flatnonzero(np.diff(command[:, 2]) == -1.0) + 1, 0].tolist():
        on_again = command[(command[:, 0] > at) & (command[:, 2] == 1.0), 0]
        end = min([at + WAIT_S, *on_again[:1].tolist()])
        part: Float64 = machine[(machine[:, 0] >= at) & (machine[:, 0] <= end)]
        stands = np.flatnonzero(part[:, 2] < STANDS_RADPS)
        if len(stands) and part[0, 2] > RUNS_RADPS:
            found.append((at, float(part[stands[0], 0]) - at))
    return found
