"""A small method of moments for perfect conductors: the electric field integral equation on triangles.

Rao-Wilton-Glisson functions expand and test the current [RaoWiltonGlisson1982]. Near triangles integrate 1 / R in
closed form [Wilton1984]. An elementary dipole illuminates the body and receives its echo. Time runs as exp(+j w t).
"""

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import coo_array

NEAR = 1.2
"""Triangles nearer than this many times their size count as near."""
_AT_ONCE = 600  # test points at once
_INNER = np.array([[2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]])  # three points, degree 2


def grid(edges_m, corner, along, up):
    """Triangles (t, 3, 3) of a rectangle spanned by two vectors from a corner, finer at its rim."""
    sides = []
    for vector in (along, up):
        count = int(np.ceil(np.linalg.norm(vector) / edges_m)) + 1
        even = np.linspace(0, 1, count + 1)
        sides.append(even - 0.35 * np.sin(2 * np.pi * even) / (2 * np.pi))
    u, v = np.meshgrid(*sides, indexing="ij")
    points = np.asarray(corner) + u[..., None] * np.asarray(along) + v[..., None] * np.asarray(up)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    even = ((np.indices(a.shape[:2]).sum(0) % 2) == 0)[..., None, None]
    one = np.where(even, np.stack([a, b, c], 2), np.stack([a, b, d], 2))
    two = np.where(even, np.stack([a, c, d], 2), np.stack([b, c, d], 2))
    return np.concatenate([one.reshape(-1, 3, 3), two.reshape(-1, 3, 3)])


def plate(size_m, edges_m):
    """A plate in the plane x = 0, about the origin: square, or of a width and a height."""
    width, height = size_m * np.ones(2)
    return grid(edges_m, (0, -width / 2, -height / 2), (0, width, 0), (0, 0, height))


def box(size_m, edges_m):
    """A cube about the origin, normals outward."""
    half, parts = np.asarray(size_m) / 2 * np.ones(3), []
    for axis in range(3):
        u, v = np.zeros(3), np.zeros(3)
        u[(axis + 1) % 3], v[(axis + 2) % 3] = 2 * half[(axis + 1) % 3], 2 * half[(axis + 2) % 3]
        start = -half
        parts.append(grid(edges_m, start, v, u))
        start = -half * np.where(np.arange(3) == axis, -1, 1)
        parts.append(grid(edges_m, start, u, v))
    return np.concatenate(parts)


def dihedral(size_m, edges_m):
    """Two square plates at right angles that meet on the z axis and open towards +x."""
    side, up = size_m * np.sqrt(0.5), (0, 0, size_m)
    corner = (0, 0, -size_m / 2)
    return np.concatenate([grid(edges_m, corner, (side, s * side, 0), up) for s in (-1, 1)])


def ball(radius_m, level):
    """A sphere about the origin of 20 * level**2 triangles of its area."""
    import trimesh

    mesh = trimesh.creation.icosahedron()
    corners = mesh.vertices[mesh.faces]
    i, j = (a.ravel() for a in np.meshgrid(np.arange(level), np.arange(level), indexing="ij"))
    up = i + j < level
    down = i + j < level - 1
    cells = np.concatenate([
        np.stack([np.stack([i + a, j + b], 1)[up] for a, b in ((0, 0), (1, 0), (0, 1))], 1),
        np.stack([np.stack([i + a, j + b], 1)[down] for a, b in ((1, 0), (1, 1), (0, 1))], 1)]) / level  # fmt: skip
    weight = np.concatenate([1 - cells.sum(2, keepdims=True), cells], 2)
    points = np.einsum("cvk,fkx->fcvx", weight, corners).reshape(-1, 3, 3)
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    area = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1).sum() / 2
    return radius_m * np.sqrt(4 * np.pi / area) * points


class Moments:
    """A body (t, 3, 3) [m] at one frequency, factorised once for any number of dipoles."""

    def __init__(self, triangles, frequency_hz):
        self.k = 2 * np.pi * frequency_hz / 299_792_458.0
        self.corners = np.asarray(triangles, float)
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        self.area = np.linalg.norm(cross, axis=1) / 2
        self.normal = cross / (2 * self.area[:, None])
        self._functions()
        self.points = np.einsum("qv,tvx->tqx", _INNER, self.corners).reshape(-1, 3)
        self.lu = lu_factor(self._matrix(), overwrite_a=True, check_finite=False)

    def _functions(self):
        """Vertex values of the functions (3 t, n) by component, and their divergence (3 t, n)."""
        many = len(self.corners)
        flat = np.round(self.corners.reshape(-1, 3) / (1e-6 * np.ptp(self.corners))).astype(np.int64)
        ids = np.unique(flat, axis=0, return_inverse=True)[1].reshape(many, 3)
        edge = np.stack([np.roll(ids, -1, 1), np.roll(ids, -2, 1)], -1).reshape(-1, 2)  # opposite corner v
        _, index, count = np.unique(np.sort(edge, 1), axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(index, kind="stable")
        first = (np.cumsum(count) - count)[count >= 2]
        # where more than two triangles meet, each further one shares a function with the first
        rows = [order[np.stack([first, first + i + 1], 1)[count[count >= 2] > i + 1]] for i in range(count.max() - 1)]
        halves = np.concatenate(rows)
        self.count = len(halves)
        tri, opposite = halves // 3, halves % 3
        ends = np.stack([(opposite + 1) % 3, (opposite + 2) % 3], -1)
        span = self.corners[tri[:, 0], ends[:, 0, 0]] - self.corners[tri[:, 0], ends[:, 0, 1]]
        length = np.linalg.norm(span, axis=1)
        sign = np.array([1.0, -1.0])
        slope = sign * length[:, None] / (2 * self.area[tri])  # (n, 2)
        free = self.corners[tri, opposite]  # (n, 2, 3)
        value = slope[..., None, None] * (self.corners[tri] - free[:, :, None])  # (n, 2, 3 vertices, 3)
        row = (3 * tri[..., None] + np.arange(3)).ravel()
        column = np.repeat(np.arange(self.count), 6)
        shape = (3 * many, self.count)
        self.values = [coo_array((value[..., c].ravel(), (row, column)), shape).tocsr() for c in range(3)]
        self.divergence = coo_array((np.repeat(2 * slope, 3), (row, column)), shape).tocsr()

    def _at_points(self, values):
        """Vertex values as values at the inner points times their weights (3 t, n)."""
        t = np.arange(len(self.corners))
        weight = (self.area[:, None, None] / 3 * _INNER).ravel()
        row = np.broadcast_to(3 * t[:, None, None] + np.arange(3)[:, None], (len(t), 3, 3)).ravel()
        column = np.broadcast_to(3 * t[:, None, None] + np.arange(3), (len(t), 3, 3)).ravel()
        return (coo_array((weight, (row, column))).tocsr() @ values).tocsr()

    def _matrix(self):
        """The impedance matrix over the impedance of free space (n, n)."""
        parts = [*self.values, self.divergence]
        inner = [self._at_points(v) for v in parts]
        near, pairs = self._near()
        scale = 1j * self.k / (4 * np.pi)
        factors = [scale, scale, scale, -scale / self.k**2]
        out = np.zeros((self.count, self.count), complex)
        step = 3 * (_AT_ONCE // 3)
        inner_t = [m.T.tocsr() for m in inner]
        for begin in range(0, len(self.points), step):
            rows = slice(begin, begin + step)
            test = self.points[rows]
            square = np.maximum(
                (test**2).sum(1)[:, None] + (self.points**2).sum(1) - 2 * test @ self.points.T, 1e-24)  # fmt: skip
            distance = np.sqrt(square)
            kernel = np.exp(-1j * self.k * distance) / distance
            blocks = kernel.reshape(len(test) // 3, 3, -1, 3)
            held = pairs[(pairs[:, 0] >= begin // 3) & (pairs[:, 0] < (begin + len(test)) // 3)]
            blocks[held[:, 0] - begin // 3, :, held[:, 1], :] = 0
            extra = near[rows]
            for values, quadrature, tested, factor in zip(parts, inner, inner_t, factors, strict=True):
                mine = tested[:, rows]
                used = np.flatnonzero(np.diff(mine.indptr))
                potential = (quadrature.T @ kernel.T).T + (extra @ values).toarray()
                out[used] += factor * (mine[used] @ potential)
        return out

    def _near(self):
        """Integrals of the Green function times the vertex functions of near triangles, sparse (3 t, 3 t)."""
        from scipy.spatial import cKDTree

        centre = self.corners.mean(1)
        size = np.linalg.norm(self.corners - centre[:, None], axis=2).max(1)
        tree = cKDTree(centre)
        sets = tree.query_ball_point(centre, 2 * NEAR * size.max())
        one = np.repeat(np.arange(len(centre)), [len(s) for s in sets])
        two = np.concatenate([np.asarray(s, int) for s in sets])
        kept = np.linalg.norm(centre[one] - centre[two], axis=1) < NEAR * (size[one] + size[two])
        one, two = one[kept], two[kept]
        test = self.points.reshape(-1, 3, 3)[one].reshape(-1, 3)  # (3 p, 3)
        source = np.repeat(two, 3)
        value = self._static(test, source).astype(complex)
        for share, weight in zip(*_outer(), strict=True):
            point = np.einsum("v,pvx->px", share, self.corners[source])
            distance = np.maximum(np.linalg.norm(test - point, axis=1), 1e-12)
            rest = np.where(self.k * distance < 1e-4, -1j * self.k,
                            (np.exp(-1j * self.k * distance) - 1) / distance)  # fmt: skip
            value += (weight * self.area[source] * rest)[:, None] * share
        row = np.repeat((3 * one[:, None] + np.arange(3)).ravel(), 3)
        column = (3 * source[:, None] + np.arange(3)).ravel()
        size = 3 * len(self.corners)
        return coo_array((value.ravel(), (row, column)), (size, size)).tocsr(), np.stack([one, two], 1)

    def _static(self, point, tri):
        """Integrals (p, 3) of the three vertex functions over R, in closed form [Wilton1984]."""
        corners, normal = self.corners[tri], self.normal[tri]
        height = np.einsum("px,px->p", point - corners[:, 0], normal)
        foot = point - height[:, None] * normal
        h = abs(height)
        constant, linear = np.zeros(len(point)), np.zeros((len(point), 3))
        for i in range(3):
            a, b = corners[:, i], corners[:, (i + 1) % 3]
            along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
            out = np.cross(along, normal)
            low, high = (np.einsum("px,px->p", v - foot, along) for v in (a, b))
            beside = np.einsum("px,px->p", a - foot, out)
            r0 = beside**2 + height**2
            ra, rb = np.sqrt(low**2 + r0), np.sqrt(high**2 + r0)
            far = low + high < 0  # the same logarithm without cancellation
            log = np.where(far, np.log(np.maximum(ra - low, 1e-30) / np.maximum(rb - high, 1e-30)),
                           np.log(np.maximum(rb + high, 1e-30) / np.maximum(ra + low, 1e-30)))  # fmt: skip
            log = np.where(r0 < 1e-24, 0.0, log)
            angle = np.arctan2(beside * high, r0 + h * rb) - np.arctan2(beside * low, r0 + h * ra)
            constant += beside * log - h * angle
            linear += 0.5 * (r0 * log + high * rb - low * ra)[:, None] * out
        heights = np.cross(normal[:, None], np.roll(corners, -2, 1) - np.roll(corners, -1, 1)) / (
            2 * self.area[tri][:, None, None])  # gradient of each vertex function  # fmt: skip
        share = np.einsum("pvx,pvx->pv", heights, foot[:, None] - np.roll(corners, -1, 1))
        return share * constant[:, None] + np.einsum("pvx,px->pv", heights, linear)

    def _tested(self, origins, fields):
        """Reactions (n, d) of the functions with dipoles at origins (d, 3) along unit vectors (d, 3)."""
        out = np.zeros((self.count, len(origins)), complex)
        offset = self.points[:, None] - origins
        r = np.linalg.norm(offset, axis=2)
        unit = offset / r[..., None]
        along = np.einsum("pdx,dx->pd", unit, fields)
        kr = 1j * self.k * r
        one, two = 1 + 1 / kr + 1 / kr**2, 1 + 3 / kr + 3 / kr**2
        wave = np.exp(-kr) / r
        for c in range(3):
            field = wave * (one * fields[:, c] - two * along * unit[..., c])
            out += self._at_points(self.values[c]).T @ field
        return out

    def path_gain(self, origins, fields, seen_fields=None):
        """Path gain (d) back to each dipole of gain 1 across itself; `seen_fields` receive (None: the same)."""
        places = np.asarray(origins, float)
        sent = self._tested(places, np.asarray(fields, float))
        seen = sent if seen_fields is None else self._tested(places, np.asarray(seen_fields, float))
        # (lambda / 4 pi) times the echo's field, which reciprocity takes from the reaction with the current
        return -0.125j / np.pi * (seen * lu_solve(self.lu, sent, check_finite=False)).sum(0)

    def bistatic(self, origin, field, other, seen_field):
        """Path gain from one dipole to another elsewhere, without the direct path."""
        sent, seen = (self._tested(np.asarray(o, float)[None], np.asarray(f, float)[None])
                      for o, f in ((origin, field), (other, seen_field)))  # fmt: skip
        return complex(-0.125j / np.pi * (seen * lu_solve(self.lu, sent)).sum())


def _outer():
    """Seven points of a triangle, by their shares of its vertices, and weights: exact to degree 5."""
    a, b = 0.470142064105115, 0.101286507323456
    share = [[1 / 3] * 3]
    for x in (a, b):
        share += [[1 - 2 * x, x, x], [x, 1 - 2 * x, x], [x, x, 1 - 2 * x]]
    return np.array(share), np.array([0.225] + [0.132394152788506] * 3 + [0.125939180544827] * 3)
