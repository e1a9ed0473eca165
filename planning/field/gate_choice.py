"""The gate of a surveyed site with several, each with lanes from the yard to the field."""

from shapely.geometry import LineString, Point, Polygon

from configs.site import Lane, Site
from messages.errors import FieldError

AT_GATE_M = 1.0  # from a lane to the line between the posts of its gate


def with_gate(site: Site, gate_m: tuple[float, float] | None) -> Site:
    """The site with the lanes through the gate next to a point, else with the shortest way; raises FieldError.

    A way ends with the first lane that ends in the field, the next one begins with the lane after it.
    """
    ways = _ways(site)
    if gate_m is None:
        return site if len(ways) < 2 else site.model_copy(update={"lanes": min(ways, key=_length_m)})
    if not site.gates:
        raise FieldError(f"gate_m: site {site.name!r} has no gate")
    gate = min(site.gates, key=lambda g: LineString(g.posts_m).distance(Point(gate_m)))
    opening = LineString(gate.posts_m)
    through = [way for way in ways if min(_line(lane).distance(opening) for lane in way) <= AT_GATE_M]
    if not through:
        raise FieldError(f"gate_m: no lane of site {site.name!r} leads through {gate.name!r}: add one")
    return site.model_copy(update={"lanes": min(through, key=_length_m)})


def _ways(site: Site) -> list[tuple[Lane, ...]]:
    field, ways = Polygon(site.boundary_m), [list[Lane]()]
    for lane in site.lanes:
        ways[-1].append(lane)
        if field.contains(Point(lane.center_m[-1])):
            ways.append([])
    return [tuple(way) for way in ways if way]


def _line(lane: Lane) -> LineString:
    return LineString(lane.center_m)


def _length_m(way: tuple[Lane, ...]) -> float:
    return sum(_line(lane).length for lane in way)
