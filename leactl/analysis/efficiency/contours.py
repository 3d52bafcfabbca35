"""Contour lines over a warped grid: each cell is two triangles, in which the level is crossed along a straight line."""

import numpy as np

from leactl.analysis.statistics.regression import Array

Crossing = tuple[int, int]  # the two corners of an edge that a line crosses, the lower number first
Line = tuple[tuple[float, ...], tuple[float, ...]]
Corner = tuple[float, float, float]  # x, y, z
Polygon = tuple[tuple[float, float], ...]  # x, y of each corner


def contours(x: Array, y: Array, z: Array, level: float) -> list[Line]:
    """Trace the contour lines of one level; return x and y of each.

    Parameters
    ----------
    x, y, z : of the grid's corners, shape (rows, columns) each.
    """
    flat = np.where(z.ravel() == level, np.nextafter(level, np.inf), z.ravel())  # no line ends in a corner
    above_level = flat > level
    neighbours: dict[Crossing, list[Crossing]] = {}
    for corners in triangles(*z.shape):
        if not np.isfinite(flat[list(corners)]).all():
            continue
        edges = [(min(a, b), max(a, b)) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]
        crossed = [edge for edge in edges if above_level[edge[0]] != above_level[edge[1]]]
        if crossed:
            first, second = crossed
            neighbours.setdefault(first, []).append(second)
            neighbours.setdefault(second, []).append(first)

    def crossing_point(edge: Crossing) -> tuple[float, float]:
        a, b = edge
        share = (level - flat[a]) / (flat[b] - flat[a])
        return tuple(float(c.flat[a] + share * (c.flat[b] - c.flat[a])) for c in (x, y))  # type: ignore[return-value]

    lines = []
    while neighbours:
        start = next((edge for edge, others in neighbours.items() if len(others) == 1), next(iter(neighbours)))
        path = [start]
        while ahead := neighbours.get(path[-1]):
            current, following = path[-1], ahead.pop()
            neighbours[following].remove(current)
            path.append(following)
        for edge in set(path):
            if edge in neighbours and not neighbours[edge]:
                del neighbours[edge]
        points = [crossing_point(edge) for edge in path]
        lines.append((tuple(p[0] for p in points), tuple(p[1] for p in points)))
    return lines


def band(x: Array, y: Array, z: Array, low: float, high: float) -> list[Polygon]:
    """Polygons of the grid where `low <= z < high`, z being linear in each triangle; cells with a NaN corner have none.

    Parameters
    ----------
    x, y, z : of the grid's corners, shape (rows, columns) each.
    """
    corners = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    polygons = []
    for numbers in triangles(*z.shape):
        polygon: list[Corner] = [(float(a), float(b), float(c)) for a, b, c in corners[list(numbers)]]
        if not np.isfinite(polygon).all():
            continue
        for level, upwards in ((low, True), (high, False)):
            polygon = above(polygon, level, upwards)
        if len(polygon) > 2:
            polygons.append(tuple((a, b) for a, b, _ in polygon))
    return polygons


def above(polygon: list[Corner], level: float, upwards: bool) -> list[Corner]:
    """Cut a polygon at a level and return the part on one side (Sutherland, Hodgman 1974)."""
    if not np.isfinite(level):
        return polygon
    kept: list[Corner] = []
    for corner, next_corner in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        inside = (corner[2] >= level) == upwards
        if inside:
            kept.append(corner)
        if inside != ((next_corner[2] >= level) == upwards):
            share = (level - corner[2]) / (next_corner[2] - corner[2])
            a, b = (start + share * (end - start) for start, end in zip(corner[:2], next_corner[:2], strict=True))
            kept.append((a, b, level))
    return kept


def triangles(rows: int, columns: int) -> list[tuple[int, int, int]]:
    """Return the corner numbers of two triangles for each cell of a grid."""
    corners = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            a = row * columns + column
            b, c, d = a + 1, a + columns, a + columns + 1
            corners += [(a, b, d), (a, d, c)]
    return corners
