"""Polygons -> triangles: a fan from the first corner where that is right, ears cut (mapbox-earcut) where it is not.

A fan is right if its triangles, seen along the polygon's normal, all turn the same way and go round the first corner once at
most; this holds for all convex polygons. Otherwise the fan covers a notch of the polygon.
"""

import numpy as np

_SLACK = 1e-6  # part of a polygon's area that a fan may cover wrongly: collinear corners are rounded
_FLAT = 1e-3  # a polygon that leaves its plane by more of its size is not planar
_FLOAT32_MAX = float(np.finfo(np.float32).max)


def fan(lengths: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return polygons as triangles (v0, vk, vk+1), in the order of the polygons.

    Parameters
    ----------
    lengths : (n,) int
        Corners of each polygon; those with fewer than three give no triangle.
    corners : (sum(lengths),) int

    Returns
    -------
    faces : (m, 3) int64
    """
    corners = np.asarray(corners, np.int64)
    if np.all(lengths == 3):
        return corners.reshape(-1, 3)
    lengths = np.asarray(lengths, np.int64)
    n_triangles = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, n_triangles)
    k = np.arange(first.size) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    return np.stack([corners[first], corners[first + k + 1], corners[first + k + 2]], axis=1)


def triangulate(vertices: np.ndarray, lengths: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the triangles of polygons, in the order of the polygons, and notes on polygons of ambiguous shape.

    Polygons with vertices that are out of range, NaN or beyond float32 become fans.

    Parameters
    ----------
    vertices : (n_vertices, 3) float32 or float64
    lengths, corners
        As for ``fan``.

    Returns
    -------
    faces : (m, 3) int64
        A polygon of n corners gives n - 2 triangles; fewer where ears are cut at collinear corners.
    notes : tuple of str
    """
    faces = fan(lengths, corners)
    if np.all(lengths == 3):
        return faces, ()
    notes = []
    short = np.flatnonzero(np.asarray(lengths) < 3)
    if short.size:
        notes.append(f"{_polygons(short, 'has', 'have')} fewer than three corners and gives no triangle")
    if not lengths.size or lengths.max() <= 3:
        return faces, tuple(notes)
    owner = np.repeat(np.arange(len(lengths)), np.maximum(lengths - 2, 0))
    suspects, bent, depth = _examine(vertices, faces, owner, lengths)
    starts = np.cumsum(lengths) - lengths
    cut: dict[int, np.ndarray] = {}
    crossing = []
    for polygon, normal in suspects:
        ring = np.asarray(corners[starts[polygon] : starts[polygon] + lengths[polygon]], np.int64)
        ears = cut_ears(np.asarray(vertices[ring], np.float64), normal)
        if ears is None:
            crossing.append(polygon)
        else:
            cut[polygon] = ring[ears]
    if cut:
        kept = ~np.isin(owner, list(cut))
        faces = np.concatenate([faces[kept], *cut.values()])
        owner = np.concatenate([owner[kept], np.repeat(list(cut), [len(ears) for ears in cut.values()])])
        faces = faces[np.argsort(owner, kind="stable")]
    if bent.size:
        notes.append(
            f"{_polygons(bent, 'is', 'are')} not planar (off the plane by up to {100 * depth:.2g} % of the size): "
            "their triangles are one of several interpretations"
        )
    if crossing:
        what = _polygons(np.array(crossing), "crosses itself", "cross themselves")
        notes.append(f"{what} or has no area: its fan may cover too much")
    return faces, tuple(notes)


def _polygons(numbers: np.ndarray, verb: str, plural: str) -> str:
    if len(numbers) == 1:
        return f"1 polygon (number {numbers[0]}) {verb}"
    return f"{len(numbers):,} polygons (the first: number {numbers[0]}) {plural}"


def _examine(
    vertices: np.ndarray, faces: np.ndarray, owner: np.ndarray, lengths: np.ndarray
) -> tuple[list[tuple[int, np.ndarray]], np.ndarray, float]:
    """Return the polygons that differ from their fans, with normals; those not planar, and by what part of their size."""
    nothing: tuple[list[tuple[int, np.ndarray]], np.ndarray, float] = ([], np.zeros(0, np.int64), 0.0)
    at = np.flatnonzero(lengths[owner] > 3)
    if not len(vertices):
        return nothing
    good = np.append(np.all(np.abs(vertices) <= _FLOAT32_MAX, axis=1), False)
    listed = faces[at]
    listed[(listed < 0) | (listed >= len(vertices))] = len(vertices)
    usable = np.all(good[listed], axis=1)
    if not usable.all():
        whole = np.ones(len(lengths), bool)
        whole[owner[at[~usable]]] = False
        usable = whole[owner[at]]
        at, listed = at[usable], listed[usable]
    if not at.size:
        return nothing
    starts = np.flatnonzero(np.diff(owner[at], prepend=-1))
    numbers, group = owner[at][starts], np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(at))))
    points = np.asarray(vertices, np.float64).T
    first = points[:, listed[:, 0]]
    a, b = points[:, listed[:, 1]] - first, points[:, listed[:, 2]] - first  # (3, m): two edges of each triangle
    size = np.maximum.reduceat(np.maximum(np.abs(a), np.abs(b)).max(axis=0), starts)
    size[size == 0] = 1
    a /= size[group]
    b /= size[group]
    crosses = np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    normals = np.add.reduceat(crosses, starts, axis=1)
    heights = np.sqrt((normals**2).sum(axis=0))
    units = (normals / np.where(heights > 0, heights, 1))[:, group]
    covered = np.add.reduceat(np.abs((crosses * units).sum(axis=0)), starts)
    areas = np.add.reduceat(np.sqrt((crosses**2).sum(axis=0)), starts)
    folded = heights <= _SLACK * areas  # its parts cancel, or it has no area
    wrong = (covered - heights > _SLACK * covered) | (folded & (areas > _SLACK**2))
    large = np.flatnonzero(lengths[numbers[group]] > 4)  # a fan of two triangles goes round its corner once at most
    if large.size:
        turns = np.arctan2(np.sqrt((crosses[:, large] ** 2).sum(axis=0)), (a[:, large] * b[:, large]).sum(axis=0))
        wrong |= np.bincount(group[large], turns, len(starts)) > 2 * np.pi + _SLACK
    depths = np.maximum.reduceat(np.maximum(np.abs((a * units).sum(axis=0)), np.abs((b * units).sum(axis=0))), starts)
    bent = (depths > _FLAT) & ~folded
    normals[:, folded] = 0
    depth = float(depths[bent].max()) if bent.any() else 0.0
    return [(int(numbers[k]), normals[:, k]) for k in np.flatnonzero(wrong)], numbers[bent], depth


def cut_ears(points: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Return a polygon's triangles as numbers of its corners; None where no triangles have the polygon's area.

    Parameters
    ----------
    points : (n, 3) float64
        The corners, seen along ``normal``, (3,).

    Returns
    -------
    ears : (m, 3) int64 or None
        Turning as the polygon turns. None for a polygon that crosses itself or has no area.
    """
    from mapbox_earcut import triangulate_float64

    axis = int(np.argmax(np.abs(normal)))
    if normal[axis] == 0:
        return None
    axes = [(axis + 1) % 3, (axis + 2) % 3]
    flat = np.ascontiguousarray(points[:, axes if normal[axis] > 0 else axes[::-1]])
    flat -= flat[0]
    ears = triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(np.int64)
    a, b, c = flat[ears[:, 0]], flat[ears[:, 1]], flat[ears[:, 2]]
    areas = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    following = np.roll(flat, -1, axis=0)
    wanted = (flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum()
    if not abs(np.abs(areas).sum() - wanted) <= _SLACK * wanted:
        return None
    return np.where((areas < 0)[:, None], ears[:, ::-1], ears)


def strips(lengths: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return triangle strips as triangles that all turn as the first one of their strip; -1 begins another strip.

    Parameters
    ----------
    lengths : (n,) int
        Corners of each strip.
    corners : (sum(lengths),) int

    Returns
    -------
    faces : (m, 3) int64
    """
    pieces = [np.zeros((0, 3), np.int64)]
    for listed in np.split(np.asarray(corners, np.int64), np.cumsum(lengths)[:-1]):
        ends = np.flatnonzero(listed == -1)
        for strip in np.split(listed, ends):
            strip = strip[strip != -1]
            if len(strip) > 2:
                faces = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
                faces[1::2, :2] = faces[1::2, 1::-1]
                pieces.append(faces)
    return np.concatenate(pieces)
