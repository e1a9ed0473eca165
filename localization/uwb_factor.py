"""One range as a factor on a pose of the smoother's graph, with the scale and bias that the UWB window has learned."""

import gtsam
import numpy as np

from geometry.transforms import Float64
from localization.factors import X, skew


def range_factor(
    key: int, anchor_map_m: Float64, arm_m: Float64, range_m: float, calibration: tuple[float, float], sigma_m: float
) -> gtsam.CustomFactor:
    """Measured `range_m` from an anchor (3,) to a tag `arm_m` (3,) from the IMU; calibration is (scale, bias in m).

    gtsam's Cauchy loss bounds what an outlier can do; it is symmetric, so ranges that `range_weight` finds late should
    come with their sigma divided by the root of the weight.
    """
    arm_cross, (scale, bias_m) = skew(arm_m), calibration

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: "list[Float64] | None") -> Float64:
        pose = values.atPose3(X(key))
        R = pose.rotation().matrix()
        offset = pose.translation() + R @ arm_m - anchor_map_m
        distance = max(float(np.linalg.norm(offset)), 1e-6)
        if H is not None:
            along = scale * (offset / distance) @ R  # the pose moves in its own axes
            H[0] = np.concatenate([-along @ arm_cross, along])[None]
        return np.array([scale * distance + bias_m - range_m])

    model = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Cauchy.Create(2.5), gtsam.noiseModel.Isotropic.Sigma(1, sigma_m)
    )
    return gtsam.CustomFactor(model, [X(key)], error)
