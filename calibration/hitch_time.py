"""Times of the hitch: from commands to lift and lower, and the positions that follow them."""

import math

import numpy as np

from calibration.recording import Recording
from calibration.result import CalibrationResult, Estimate, NotEnough, plot_of
from configs.vehicle import MountedImplement, TrailedImplement
from geometry.arrays import Float64

LOW, HIGH = 0.1, 0.9  # part of the stroke in which the speed is measured
WAIT_S = 15.0  # for the stroke after a command
STEP_S = 0.02  # between two states of the machine


def hitch_times(recording: Recording, implement: MountedImplement | TrailedImplement) -> CalibrationResult:
    """Time of the whole stroke up and down (s); raises NotEnough."""
    strokes = {is_down: _strokes(recording, is_down) for is_down in (True, False)}
    if not strokes[True] or not strokes[False]:
        raise NotEnough("strokes", float(sum(bool(found) for found in strokes.values())), 2.0)
    estimates = tuple(
        _estimate(f"implement.{key}", strokes[is_down], present)
        for key, is_down, present in (("lower_s", True, implement.lower_s), ("lift_s", False, implement.lift_s))
    )
    at, duration, delay = strokes[True][0]
    machine = recording.machine
    shown = machine[(machine[:, 0] >= at - 1.0) & (machine[:, 0] <= at + 4.0)]
    line = [(0.0, 1.0), (delay, 1.0), (delay + duration, 0.0)]
    fits = max(_misfit(machine, stroke, is_down) for is_down, found in strokes.items() for stroke in found)
    return CalibrationResult(estimates, fits, plot_of("since_command", "hitch", shown[:, 0] - at, shown[:, 1], line))


def _estimate(key: str, strokes: list[tuple[float, float, float]], present: float) -> Estimate:
    durations = np.array([duration for _, duration, _ in strokes])
    least = STEP_S / (HIGH - LOW) / math.sqrt(6.0)  # two times of states that are `STEP_S` apart
    scatter = float(np.std(durations, ddof=1)) if len(durations) > 1 else 0.0
    return Estimate(key, float(durations.mean()), max(scatter, least) / math.sqrt(len(durations)), present)


def _strokes(recording: Recording, is_down: bool) -> list[tuple[float, float, float]]:
    """Time of the command, duration of the whole stroke, and delay until it begins, of each complete stroke."""
    command, machine, found = recording.command, recording.machine, []
    changes = np.flatnonzero(np.diff(command[:, 1]) == (1.0 if is_down else -1.0)) + 1
    for at in command[changes, 0]:
        part = machine[(machine[:, 0] >= at) & (machine[:, 0] <= at + WAIT_S)]
        lowered = 1.0 - part[:, 1] if is_down else part[:, 1]
        if len(part) < 2 or lowered[0] > 0.05 or lowered.max() < 0.98:
            continue
        low, high = (float(part[np.argmax(lowered >= level), 0]) for level in (LOW, HIGH))
        levels = [float(lowered[np.argmax(lowered >= level)]) for level in (LOW, HIGH)]
        duration = (high - low) / (levels[1] - levels[0])
        found.append((float(at), duration, low - levels[0] * duration - float(at)))
    return found


def _misfit(machine: Float64, stroke: tuple[float, float, float], is_down: bool) -> float:
    """Largest deviation of the position from a stroke at constant speed, over 5 % of the stroke."""
    at, duration, delay = stroke
    part = machine[(machine[:, 0] >= at) & (machine[:, 0] <= at + delay + duration)]
    share = np.clip((part[:, 0] - at - delay) / duration, 0.0, 1.0)
    return float(np.max(np.abs(part[:, 1] - (1.0 - share if is_down else share)))) / 0.05
