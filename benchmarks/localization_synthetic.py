"""Accuracy, integrity and CPU time of the localizer on synthetic drives: RTK throughout, and 30 s without GNSS.

`./headland benchmark localization_synthetic [SEEDS]`; the drives are those of tests/localization, not the simulator's.
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from localization.lidar.lidar_odometry import LidarOdometryNode
from localization.lidar.map_localization import LidarMap
from messages.perception import LidarGround
from messages.sensors import LidarScan
from tests.localization.harness import Errors, configuration, errors, run
from tests.localization.synthetic_drive import START_NS, SensorErrors, Truth, drive, tractor
from tests.localization.synthetic_shed import harrow
from tests.localization.synthetic_surroundings import scan, yard

LEGS = [(5.0, 0.0, 0.0), (14.0, 2.78, 0.0), (11.8, 1.6, 1 / 6), (60.0, 2.78, 0.0)]
CUT_S, CUT_FOR_S = 42.0, 30.0


def main(seeds: int) -> None:
    """Prints the results of each seed and the means."""
    all_errors: list[Errors] = []
    step_ms: list[float] = []
    for seed in range(1, seeds + 1):
        truth = drive(75, legs=LEGS, sensor_errors=SensorErrors(seed=seed, gnss_slow_s=30.0, slip_swing=0.003))
        began = time.thread_time()
        result = run(truth.messages)
        step_ms.append((time.thread_time() - began) / len(result.step_s) * 1e3)
        all_errors.append(errors(result, truth))
        cut = [m for m in truth.messages if m[1] != "gnss/main" or m[2].stamp_ns < START_NS + int(CUT_S * 1e9)]
        print(f"seed {seed}: {_rtk(all_errors[-1])}, {step_ms[-1]:.2f} ms a step (CPU)")
        print("   no GNSS, no lidar:", _outage(errors(run(cut), truth)))
        timed = _Timed(LidarOdometryNode(tractor(), None, configuration().lidar_odometry))
        with_lidar = errors(run(cut, lidar=(timed, _scans(truth))), truth)
        print("   no GNSS, lidar:   ", _outage(with_lidar), f"{timed.ms:.1f} ms a matched scan (CPU)", flush=True)
        mapped = _Timed(LidarMap(tractor(), harrow(), None, configuration().lidar_map))
        timed = _Timed(LidarOdometryNode(tractor(), None, configuration().lidar_odometry))
        both = run(cut, lidar=(timed, _scans(truth)), lidar_map=(mapped, _scans_by_name(truth)))
        print("   no GNSS, and map: ", _outage(errors(both, truth)), f"{mapped.ms:.1f} ms a match (CPU)", flush=True)
    joined = Errors(*(np.concatenate([getattr(e, name) for e in all_errors]) for name in Errors.__dataclass_fields__))
    print(f"all: {_rtk(joined)}, {np.mean(step_ms):.2f} ms a step")


def _scans(truth: Truth) -> Callable[[int], tuple[LidarScan, LidarGround] | None]:
    world, rng = yard(), np.random.default_rng(0)
    return lambda stamp_ns: scan(truth, stamp_ns, world, rng) if stamp_ns > START_NS + 200_000_000 else None


def _scans_by_name(truth: Truth) -> Callable[[int], dict[str, tuple[LidarScan, LidarGround]]]:
    scans = _scans(truth)

    def named(stamp_ns: int) -> dict[str, tuple[LidarScan, LidarGround]]:
        pair = scans(stamp_ns)
        return {"front": pair} if pair is not None else {}

    return named


class _Timed:
    """Lidar node with the CPU time of its steps."""

    def __init__(self, node: LidarOdometryNode | LidarMap) -> None:
        self._node, self._spent, self._matched = node, 0.0, 0

    def step(self, now_ns, inbox):  # type: ignore[no-untyped-def]
        began = time.thread_time()
        out = list(self._node.step(now_ns, inbox))
        self._spent += time.thread_time() - began
        self._matched += 1
        return out

    @property
    def ms(self) -> float:
        return 1e3 * self._spent / max(self._matched, 1)


def _rtk(e: Errors) -> str:
    m = e.t_s > 10
    along, across, up = 100 * np.sqrt(np.mean(e.p_m[m] ** 2, axis=0))
    yaw = np.degrees(np.sqrt(np.mean(e.turn_rad[m, 2] ** 2)))
    return (
        f"RMSE along {along:.2f} across {across:.2f} up {up:.2f} cm, across σ {100 * e.p_m[m, 1].std():.2f} cm, "
        f"yaw {yaw:.3f}°, NEES xy {e.nees[m, 0].mean():.2f} six {e.nees[m, 1].mean():.2f}"
    )


def _outage(e: Errors) -> str:
    cells = []
    for after_s in (5.0, 10.0, 20.0, CUT_FOR_S - 0.5):
        k = int(np.argmin(np.abs(e.t_s - CUT_S - after_s)))
        along, across, _ = 100 * e.p_m[k]
        cells.append(f"{after_s:.0f} s: along {along:.1f} across {across:.1f} (PL {100 * e.level_m[k]:.0f}) cm")
    return "; ".join(cells)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
