"""Factor of ranges on a pose of the graph and on scale and bias of every anchor."""

import gtsam
import numpy as np

from geometry.arrays import Float64, Int64
from localization.graph.factors import C, X


def expected_ranges(
    T_map_body: Float64, calibration: Float64, anchors_map_m: Float64, arms_m: Float64, rows: Int64
) -> tuple[Float64, Float64, Float64]:
    """Expected values of n ranges, with derivatives by the pose (n, 6) and by the calibration (n, 2a).

    `anchors_map_m` (a, 3); range i is from anchor `rows[i]` to a tag with lever arm `arms_m[i]` in the body;
    `calibration` (2a,) holds the scale errors of all anchors, then their biases (m).
    """
    R, n, a = T_map_body[:3, :3], len(rows), len(anchors_map_m)
    offset = T_map_body[:3, 3] + arms_m @ R.T - anchors_map_m[rows]
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
    scale = 1.0 + calibration[rows]
    along = (scale / distance)[:, None] * (offset @ R)  # derivative in body axes
    by_calibration = np.zeros((n, 2 * a))
    by_calibration[np.arange(n), rows], by_calibration[np.arange(n), a + rows] = distance, 1.0
    return scale * distance + calibration[a + rows], np.hstack([np.cross(arms_m, along), along]), by_calibration


def ranges_factor(
    key: int, anchors_map_m: Float64, arms_m: Float64, rows: Int64, range_m: Float64, sigma_m: Float64
) -> gtsam.CustomFactor:
    """Measured ranges (n,) as in `expected_ranges`, on pose X and calibration C of a keyframe."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: "list[Float64] | None") -> Float64:
        pose = values.atPose3(X(key)).matrix()
        expected, by_pose, by_calibration = expected_ranges(pose, values.atVector(C(key)), anchors_map_m, arms_m, rows)
        if H is not None:
            H[0], H[1] = by_pose, by_calibration
        return expected - range_m

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigma_m), [X(key), C(key)], error)
