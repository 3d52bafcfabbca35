"""Contour lines over a warped grid: each cell is two triangles, in which the level is crossed along a straight line."""

import numpy as np

from leactl.analysis.regression import Array

Crossing = tuple[int, int]  # the two corners of an edge that a line crosses, the lower number first
Line = tuple[tuple[float, ...], tuple[float, ...]]


def contours(x: Array, y: Array, z: Array, level: float) -> list[Line]:
    """Lines of one level: x and y of each; cells with a NaN corner have none.

    Parameters
    ----------
    x, y, z : of the grid's corners, shape (rows, columns) each.
    """
    flat = np.where(z.ravel() == level, np.nextafter(level, np.inf), z.ravel())  # no line ends in a corner
    over = flat > level
    neighbours: dict[Crossing, list[Crossing]] = {}
    for corners in triangles(*z.shape):
        if not np.isfinite(flat[list(corners)]).all():
            continue
        edges = [(min(a, b), max(a, b)) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]
        crossed = [edge for edge in edges if over[edge[0]] != over[edge[1]]]
        if crossed:
            first, second = crossed
            neighbours.setdefault(first, []).append(second)
            neighbours.setdefault(second, []).append(first)

    def at(edge: Crossing) -> tuple[float, float]:
        a, b = edge
        share = (level - flat[a]) / (flat[b] - flat[a])
        return tuple(float(c.flat[a] + share * (c.flat[b] - c.flat[a])) for c in (x, y))  # type: ignore[return-value]

    lines = []
    while neighbours:
        start = next((edge for edge, others in neighbours.items() if len(others) == 1), next(iter(neighbours)))
        path = [start]
        while ahead := neighbours.get(path[-1]):
            here, beyond = path[-1], ahead.pop()
            neighbours[beyond].remove(here)
            path.append(beyond)
        for edge in set(path):
            if edge in neighbours and not neighbours[edge]:
                del neighbours[edge]
        points = [at(edge) for edge in path]
        lines.append((tuple(p[0] for p in points), tuple(p[1] for p in points)))
    return lines


def triangles(rows: int, columns: int) -> list[tuple[int, int, int]]:
    """Corner numbers of two triangles a cell."""
    found = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            a = row * columns + column
            b, c, d = a + 1, a + columns, a + columns + 1
            found += [(a, b, d), (a, d, c)]
    return found
