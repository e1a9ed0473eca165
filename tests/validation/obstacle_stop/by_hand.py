"""Margins on the first forty KITTI frames by hand: label rows, speeds and curvature as numbers, formulas written out.

Nothing here comes from the code under test. Frame k is at 0.1 k s. The camera is 0.27 m ahead of the lidar, the lidar
0.76 m ahead of the rear axle, the bumper 3.66 m; the car is 1.82 m wide and has 0.3 m of side margin. It drives a left
bend of constant curvature, so that its path is a ring about one centre.

*Van*: at 0 s it is 9.3 m ahead along the bend and drives away; S(3.43 m/s) = 5.1 m: margin 4.2 m, more later, so
no demand.

*Cyclist*: drifts from the right into the path, predictably, and is in it from 3.3 s on, 5.1 m ahead of the bumper;
S(3.56 m/s) = 5.4 m: a stop is due at once. A speed limit of 2.4 m/s is requested at 2.55 s, except for 0.04 s before
the next scan, a stop from 2.75 s on, so that the worst-case brake acts from 2.89 s and the ghost falls behind the car.
Its smallest gap is 4.5 m, at 3.5 s.
"""

import math

import numpy as np

FRONT_M, HALF_WIDTH_M, CAMERA_M = 3.66, 1.4, 0.27 + 0.76  # half width in manual driving: conditions file
REACTION_S, DEAD_S, BUILD_UP_S, BRAKE_MPS2 = 0.6, 0.3, 0.4, 2.5  # docs/requirements.md section 4
REQUEST_S, WITHDRAWN_S = 2.548, 0.04  # delivery of the first request to brake, its interruption; the tests assert both
SPEEDS_S = np.arange(25, 40) * 0.1
SPEEDS_MPS = np.array([3.25, 3.25, 3.27, 3.29, 3.32, 3.36, 3.42, 3.49, 3.56, 3.64, 3.73, 3.82, 3.92, 4.01, 4.10])
VAN_SPEED_MPS, VAN_CURVATURE_RADPM = 3.43, 0.040  # at 0 s; the bend is a little tighter there
CURVATURE_RADPM = 0.037  # from 2.5 s on: 0.12 rad/s at 3.25 m/s up to 0.155 rad/s at 4.1 m/s
# label rows: length, width; x (right), z (ahead), rotation about the axis down
VAN_M, VAN = (4.43, 1.82), (-4.552, 13.410, -2.115)
CYCLIST_M = (1.785, 0.825)
CYCLIST = np.array([
    (0.791, 7.805, -1.982), (0.688, 7.880, -1.970), (0.585, 7.955, -1.957), (0.502, 7.989, -1.943),
    (0.419, 8.023, -1.928), (0.336, 8.058, -1.914), (0.253, 8.092, -1.899), (0.170, 8.126, -1.885),
])  # fmt: skip
CYCLIST_S = np.arange(32, 40) * 0.1


def stopping_distance_m(speed_mps: float) -> float:
    """S = v t_r + v t_b − a t_b² / 6 + (v − a t_b / 2)² / (2 a)."""
    v, a, t_b = speed_mps, BRAKE_MPS2, BUILD_UP_S
    return v * REACTION_S + v * t_b - a * t_b**2 / 6.0 + (v - 0.5 * a * t_b) ** 2 / (2.0 * a)


def gap_m(
    size_m: tuple[float, float], row: tuple[float, float, float], curvature_radpm: float, dx_m: float, dy_m: float
) -> float:
    """Distance along a left bend until the bumper touches a labelled box displaced by `dx_m`, `dy_m`; inf: never.

    A point at radius ρ and angle φ about the centre of the bend is at the bumper when ρ sin(φ − α) = 3.66 m, and in
    the path when it is then less than half a width aside.
    """
    x_right, z, turn = row
    along = np.linspace(-0.5, 0.5, 401)
    edges = [(along, np.full(401, s)) for s in (-0.5, 0.5)] + [(np.full(401, s), along) for s in (-0.5, 0.5)]
    a, b = size_m[0] * np.concatenate([e[0] for e in edges]), size_m[1] * np.concatenate([e[1] for e in edges])
    ahead, left = -math.sin(turn), -math.cos(turn)  # heading of the box
    x, y = z + CAMERA_M + dx_m + a * ahead - b * left, -x_right + dy_m + a * left + b * ahead
    radius_m = 1.0 / curvature_radpm
    rho, phi = np.hypot(x, radius_m - y), np.arctan2(x, radius_m - y)
    aside = radius_m - np.sqrt(rho**2 - FRONT_M**2)
    gaps = radius_m * (phi - np.arcsin(FRONT_M / rho))
    return float(np.min(gaps[np.abs(aside) <= HALF_WIDTH_M], initial=math.inf))


def cyclist_gap_m(t_s: float, dx_m: float = 0.0, dy_m: float = 0.0) -> float:
    """Gap between the recorded car and the cyclist."""
    x, z, turn = (float(np.interp(t_s, CYCLIST_S, column)) for column in CYCLIST.T)
    return gap_m(CYCLIST_M, (x, z, turn), CURVATURE_RADPM, dx_m, dy_m)


def van_margin_m(dx_m: float = 0.0, dy_m: float = 0.0) -> float:
    """Margin to the van at 0 s, when it is nearest."""
    return gap_m(VAN_M, VAN, VAN_CURVATURE_RADPM, dx_m, dy_m) - stopping_distance_m(VAN_SPEED_MPS)


def due_s(dx_m: float = 0.0, dy_m: float = 0.0) -> float:
    """First label at which the cyclist is in the path within S; infinite for none."""
    speeds = np.interp(CYCLIST_S, SPEEDS_S, SPEEDS_MPS).tolist()
    labels = zip(CYCLIST_S.tolist(), speeds, strict=True)
    return min((t for t, v in labels if cyclist_gap_m(t, dx_m, dy_m) < stopping_distance_m(v)), default=math.inf)


def behind_m(t_s: float, request_s: float) -> float:
    """How far the ghost is behind the car: it brakes from the dead time after the request on, growing over 0.4 s."""
    tau = t_s - request_s - DEAD_S
    if tau <= 0.0:
        return 0.0
    v0, a, t_b = float(np.interp(request_s + DEAD_S, SPEEDS_S, SPEEDS_MPS)), BRAKE_MPS2, BUILD_UP_S
    ghost = v0 * tau - a * min(tau, t_b) ** 3 / (6.0 * t_b)
    if tau > t_b:
        ghost -= 0.5 * a * t_b * (tau - t_b) + 0.5 * a * (tau - t_b) ** 2
    grid = np.linspace(t_s - tau, t_s, 200)
    return float(np.trapezoid(np.interp(grid, SPEEDS_S, SPEEDS_MPS), grid)) - ghost


def cyclist_margin_m(dx_m: float = 0.0, dy_m: float = 0.0, late_s: float = 0.0) -> float:
    """Smallest gap between ghost and cyclist after a request delivered late, with labels displaced."""
    request_s = REQUEST_S + WITHDRAWN_S + late_s
    times = np.arange(max(request_s, CYCLIST_S[0]), CYCLIST_S[-1], 0.02).tolist()
    return min(cyclist_gap_m(t, dx_m, dy_m) + behind_m(t, request_s) for t in times)
