"""Contour lines and bands over a warped grid: each cell is two triangles in which z is linear."""

import numpy as np

from leactl.analysis.statistics.regression import Array

Crossing = tuple[int, int]  # corner numbers of an edge that a line crosses, the lower number first
Line = tuple[tuple[float, ...], tuple[float, ...]]  # x and y of its points
Corner = tuple[float, float, float]  # x, y, z
Polygon = tuple[tuple[float, float], ...]  # x, y of each corner


def contours(x: Array, y: Array, z: Array, level: float) -> list[Line]:
    """Return the contour lines of one level, each as the x and the y of its points.

    Parameters
    ----------
    x, y, z : coordinates of the grid's corners, shape (rows, columns) each; cells with a NaN corner have no line.
    """
    flat_z = np.where(z.ravel() == level, np.nextafter(level, np.inf), z.ravel())  # no line ends in a corner
    above_level = flat_z > level
    neighbours: dict[Crossing, list[Crossing]] = {}
    for corners in triangles(*z.shape):
        if not np.isfinite(flat_z[list(corners)]).all():
            continue
        edges = [(min(a, b), max(a, b)) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]
        crossed_edges = [edge for edge in edges if above_level[edge[0]] != above_level[edge[1]]]
        if crossed_edges:
            first, second = crossed_edges
            neighbours.setdefault(first, []).append(second)
            neighbours.setdefault(second, []).append(first)

    def crossing_point(edge: Crossing) -> tuple[float, float]:
        a, b = edge
        share = (level - flat_z[a]) / (flat_z[b] - flat_z[a])
        x_value, y_value = (
            float(coordinate.flat[a] + share * (coordinate.flat[b] - coordinate.flat[a])) for coordinate in (x, y)
        )
        return x_value, y_value

    lines = []
    while neighbours:
        start = next((edge for edge, adjacent in neighbours.items() if len(adjacent) == 1), next(iter(neighbours)))
        path = [start]
        while next_edges := neighbours.get(path[-1]):
            last_edge, next_edge = path[-1], next_edges.pop()
            neighbours[next_edge].remove(last_edge)
            path.append(next_edge)
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
    x, y, z : coordinates of the grid's corners, shape (rows, columns) each.
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
    """Return the part of a polygon above a level of z, or below it if `upwards` is false.

    The algorithm is that of Sutherland and Hodgman (1974).
    """
    if not np.isfinite(level):
        return polygon
    kept_corners: list[Corner] = []
    for corner, next_corner in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        is_inside = (corner[2] >= level) == upwards
        if is_inside:
            kept_corners.append(corner)
        if is_inside != ((next_corner[2] >= level) == upwards):
            share = (level - corner[2]) / (next_corner[2] - corner[2])
            x, y = (start + share * (stop - start) for start, stop in zip(corner[:2], next_corner[:2], strict=True))
            kept_corners.append((x, y, level))
    return kept_corners


def triangles(rows: int, columns: int) -> list[tuple[int, int, int]]:
    """Return the corner numbers of two triangles for each cell of a grid."""
    corners = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            origin, right, below, opposite = (
                row * columns + column + offset for offset in (0, 1, columns, columns + 1)
            )
            corners += [(origin, right, opposite), (origin, opposite, below)]
    return corners
