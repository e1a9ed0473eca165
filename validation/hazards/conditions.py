"""Conditions of the operational design domain that a scenario's environment has, from plain scenario data."""

from typing import Any


def conditions_of(scenario: dict[str, Any]) -> dict[str, float]:
    """Quantities of `configs/odd.yaml` at the hard end of the scenario's ranges; without environment none."""
    environment = scenario.get("environment") or {}
    ground = environment.get("ground") or {}
    found: dict[str, float] = {}
    for stand in environment.get("vegetation") or ():
        key = "stubble_height_m" if stand["kind"] == "stubble" else "crop_height_m"
        found[key] = max(found.get(key, 0.0), _high(stand["height_m"]))
    visible = [_low(environment[air]["visibility_m"]) for air in ("fog", "rain") if environment.get(air)]
    if visible:
        found["visibility_m"] = min(visible)
    dust = environment.get("dust") or {}
    if dust.get("visibility_m") is not None:
        found["dust_visibility_m"] = _low(dust["visibility_m"])
    if dust.get("ray_share") is not None:
        found["dust_ray_share"] = _high(dust["ray_share"])
    if "wind_mps" in environment:
        found["wind_mps"] = _high(environment["wind_mps"])
    if ground.get("side_slope_deg") is not None:
        found["slope_deg"] = max(abs(v) for v in _ends(ground["side_slope_deg"]))
    rough = [_high(ground[name][key]) for name, key in (("waves", "height_m"), ("furrows", "depth_m"),
             ("ruts", "depth_m"), ("clods", "height_m")) if ground.get(name)]  # fmt: skip
    if rough:
        found["roughness_m"] = max(rough)
    return found


def _ends(value: Any) -> tuple[float, float]:
    low, high = (value, value) if isinstance(value, (int, float)) else value
    return float(low), float(high)


def _low(value: Any) -> float:
    return min(_ends(value))


def _high(value: Any) -> float:
    return max(_ends(value))
