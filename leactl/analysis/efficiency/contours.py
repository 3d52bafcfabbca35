"""Contour lines and bands over a warped grid: each cell is two triangles in which z is linear."""

import numpy as np

from leactl.analysis.statistics.regression import Array

Crossing = tuple[int, int]  # the two corners of an edge that a line crosses, the lower number first
Line = tuple[tuple[float, ...], tuple[float, ...]]  # x and y of its points
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
        x_value, y_value = (
            float(coordinate.flat[a] + share * (coordinate.flat[b] - coordinate.flat[a])) for coordinate in (x, y)
        )
        return x_value, y_value

    lines = []
    while neighbours:
        start = next((edge for edge, adjacent in neighbours.items() if len(adjacent) == 1), next(iter(neighbours)))
        path = [start]
        while ahead := neighbours.get(path[-1]):
            current, following = path[-1], ahead.pop()
            neighbours[following].remove(current)
            path.append(following)
        for edge in set(path):
            if edge in neighbours and not neighbours[edge]:
                del neighbours[edge]
        points = [crossing_point(edge) for edge in path]
        lines.append((tuple(point[0] for point in points), tuple(point[1] for point in points)))
    return lines


def band_polygons(x: Array, y: Array, z: Array, low: float, high: float) -> list[Polygon]:
    """Return polygons that cover the grid where `low <= z < high`; cells with a NaN corner have no polygon.

    Parameters
    ----------
    x, y, z : of the grid's corners, shape (rows, columns) each.
    """
    corners = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    polygons = []
    for numbers in triangles(*z.shape):
        polygon: list[Corner] = [tuple(corner) for corner in corners[list(numbers)].tolist()]
        if not np.isfinite(polygon).all():
            continue
        for level, upwards in ((low, True), (high, False)):
            polygon = cut_at_level(polygon, level, upwards)
        if len(polygon) > 2:
            polygons.append(tuple((corner[0], corner[1]) for corner in polygon))
    return polygons


def cut_at_level(polygon: list[Corner], level: float, upwards: bool) -> list[Corner]:
    """Cut a polygon at a level and return the part above it, or below it where `upwards` is false.

    The algorithm is that of Sutherland and Hodgman (1974).
    """
    if not np.isfinite(level):
        return polygon
    clipped: list[Corner] = []
    for corner, next_corner in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        inside = (corner[2] >= level) == upwards
        if inside:
            clipped.append(corner)
        if inside != ((next_corner[2] >= level) == upwards):
            share = (level - corner[2]) / (next_corner[2] - corner[2])
            x, y = (start + share * (stop - start) for start, stop in zip(corner[:2], next_corner[:2], strict=True))
            clipped.append((x, y, level))
    return clipped


def triangles(rows: int, columns: int) -> list[tuple[int, int, int]]:
    """Return the corner numbers of two triangles for each cell of a grid."""
    corners = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            this, right, below, opposite = (row * columns + column + offset for offset in (0, 1, columns, columns + 1))
            corners += [(this, right, opposite), (this, opposite, below)]
    return corners
