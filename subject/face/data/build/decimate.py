"""Half-edge collapse by quadric error (Garland and Heckbert 1997), which keeps the positions of vertices.

Only vertices of the source remain, so that every morph target of the source is a morph of the result. One half of the
face is collapsed and mirrored.
"""

import numpy as np

MIDDLE_MM = 0.05
# Weight of moving an open edge inward, relative to moving a surface.
BORDER = 20.0


def decimate(points, triangles, locked, count):
    """Selects about `count` vertices: indices into `points` and triangles among them (as positions in that list)."""
    mirror = mirror_of(points, triangles)
    half = [t for t in triangles if max(points[v, 0] for v in t) <= MIDDLE_MM]
    fixed = {v for v in locked if points[v, 0] <= MIDDLE_MM}
    half = collapse(points, half, fixed, count)
    whole = half + [(mirror[a], mirror[c], mirror[b]) for a, b, c in half]
    kept = sorted({v for t in whole for v in t})
    place = {v: i for i, v in enumerate(kept)}
    return kept, [[place[v] for v in t] for t in whole]


def mirror_of(points, triangles):
    """The mirror vertex of each vertex of a symmetric mesh (on the midline: itself)."""
    used = sorted({int(v) for t in triangles for v in t})
    flipped = points[used] * [-1, 1, 1]
    return {v: used[((points[used] - f) ** 2).sum(-1).argmin()] for v, f in zip(used, flipped)}


def collapse(points, triangles, fixed, count):
    """Collapses the cheapest edge until the mirrored whole mesh has `count` vertices."""
    triangles = [tuple(t) for t in triangles]
    middle = {v for t in triangles for v in t if abs(points[v, 0]) <= MIDDLE_MM}
    quadric = quadrics(points, triangles)
    around = {}
    for k, t in enumerate(triangles):
        for v in t:
            around.setdefault(v, set()).add(k)
    alive = dict(enumerate(triangles))
    refused = set()
    while 2 * len(around) - len(middle & around.keys()) > count:
        best = cheapest(points, alive, around, quadric, fixed, middle, refused)
        if best is None:
            break
        gone, stays = best
        if not allowed(points, alive, around, gone, stays):
            refused.add(best)
            continue
        for k in list(around.pop(gone)):
            t = alive[k]
            if stays in t:
                del alive[k]
                for v in t:
                    if v != gone:
                        around[v].discard(k)
            else:
                alive[k] = tuple(stays if v == gone else v for v in t)
                around[stays].add(k)
        quadric[stays] = quadric[stays] + quadric[gone]
        refused = {r for r in refused if gone not in r and stays not in r}
    return list(alive.values())


def cheapest(points, alive, around, quadric, fixed, middle, refused):
    """The half-edge (removed, kept) of least error. Borders collapse along borders, the midline along the midline."""
    counts = {}
    for t in alive.values():
        for i in range(3):
            edge = tuple(sorted((t[i], t[(i + 1) % 3])))
            counts[edge] = counts.get(edge, 0) + 1
    border = {v for e, n in counts.items() if n == 1 for v in e}
    best, least = None, np.inf
    for (a, b), n in counts.items():
        for gone, stays in ((a, b), (b, a)):
            if gone in fixed or (gone, stays) in refused or (gone in border and n != 1):
                continue
            if gone in middle and stays not in middle:
                continue
            p = np.append(points[stays], 1.0)
            # The length keeps the vertices of flat regions evenly spaced; without it those are removed first.
            length = np.linalg.norm(points[gone] - points[stays])
            error = p @ (quadric[gone] + quadric[stays]) @ p + 0.02 * length**3
            if error < least:
                best, least = (gone, stays), error
    return best


def allowed(points, alive, around, gone, stays):
    """Whether no triangle turns over or degenerates, and the surface remains a manifold."""
    near = lambda v: {u for k in around[v] for u in alive[k]} - {v}
    shared = near(gone) & near(stays)
    if len(shared) > sum(1 for k in around[gone] if stays in alive[k]):
        return False
    for k in around[gone]:
        t = alive[k]
        if stays in t:
            continue
        before = normal(points, t)
        # Tiny triangles (the corners of the mouth) may be moved in any direction.
        if np.linalg.norm(before) < 3.0:
            continue
        moved = tuple(stays if v == gone else v for v in t)
        after = normal(points, moved)
        area = np.linalg.norm(after)
        longest = max(np.linalg.norm(points[moved[i]] - points[moved[(i + 1) % 3]]) for i in range(3))
        if before @ after < 0.3 * np.linalg.norm(before) * area or area < 0.2 * longest**2:
            return False
    return True


def normal(points, t):
    return np.cross(points[t[1]] - points[t[0]], points[t[2]] - points[t[0]])


def quadrics(points, triangles):
    """Quadrics: squared distance to the planes around each vertex, and to planes through its open edges."""
    result, counts = {}, {}
    for t in triangles:
        n = normal(points, t)
        area = np.linalg.norm(n) / 2
        add(result, t, n, points[t[0]], area)
        for i in range(3):
            counts.setdefault(tuple(sorted((t[i], t[(i + 1) % 3]))), []).append(n)
    for (a, b), normals in counts.items():
        if len(normals) == 1:
            along = points[b] - points[a]
            add(result, (a, b), np.cross(along, normals[0]), points[a], BORDER * along @ along)
    return result


def add(result, vertices, n, through, weight):
    length = np.linalg.norm(n)
    if length == 0:
        return
    plane = np.append(n / length, -(n / length) @ through)
    for v in vertices:
        result[v] = result.get(v, np.zeros((4, 4))) + weight * np.outer(plane, plane)
