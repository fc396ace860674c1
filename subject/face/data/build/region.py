"""The part of the head that is visible from the front, and the lines that can become its outline."""

import numpy as np

VIEWS_DEG = [(yaw, pitch) for yaw in (-60, -30, 0, 30, 60) for pitch in (-20, 0, 20)]
PIXELS_PER_MM = 3.0
# Cuts in front of the ears and at the hairline.
BACK_MM = -64.0
TOP_MM = 92.0
EYEBALLS = (14598, 14742)


def face_region(points, triangles, body, landmarks, rings):
    """Triangles of the body that are visible from some view, cut at the jaw, the hairline and in front of the ears.

    The cuts create vertices between two others: they are returned as (vertex, vertex, fraction), after `points`.
    """
    inside = (points[triangles][:, :, 1] > -150).all(1)
    skin = (triangles < body).all(1)
    balls = ((triangles >= EYEBALLS[0]) & (triangles < EYEBALLS[1])).all(1)
    head = triangles[inside & (skin | balls)]
    seen = np.zeros(len(head), bool)
    for yaw, pitch in VIEWS_DEG:
        seen |= seen_share(points @ turn(yaw, pitch).T, head) > 0.5
    seen &= (head < body).all(1)
    jaw = np.array([points[landmarks[i]] for i in (8, 7, 6, 5, 4, 3, 2)])
    order = np.argsort(jaw[:, 2])
    below = lambda p: p[:, 1] - np.interp(p[:, 2], jaw[order, 2], jaw[order, 1]) + 3.0
    fields = [lambda p: TOP_MM - p[:, 1], lambda p: p[:, 2] - BACK_MM, below]
    near = np.all([(field(points)[head] > 0).any(1) for field in fields], axis=0)
    faces = without_slivers(head, seen & near, near & (head < body).all(1))
    faces = outside(faces, rings, landmarks[30])
    between = []
    for field in fields:
        faces, points, added = cut(faces, points, field(points))
        between += added
    return max(components(faces), key=len), between


def outside(triangles, rings, start):
    """Triangles that can be reached from vertex `start` without crossing the edges of a ring."""
    walls = {frozenset(pair) for ring in rings for pair in zip(ring, ring[1:] + ring[:1])}
    beside = {}
    for k, t in enumerate(triangles):
        for i in range(3):
            beside.setdefault(frozenset((t[i], t[(i + 1) % 3])), []).append(k)
    if missing := [sorted(w) for w in walls if w not in beside]:
        raise SystemExit(f"no edge between vertices {missing}: the ring is not one of this mesh")
    waiting = [k for k, t in enumerate(triangles) if start in t]
    reached = set(waiting)
    while waiting:
        t = triangles[waiting.pop()]
        for i in range(3):
            edge = frozenset((t[i], t[(i + 1) % 3]))
            for k in beside[edge] if edge not in walls else ():
                if k not in reached:
                    reached.add(k)
                    waiting.append(k)
    return [triangles[k] for k in sorted(reached)]


def cut(triangles, points, field):
    """Clips the mesh to where `field` is positive, with new vertices where edges cross zero."""
    between, made = [], {}

    def crossing(a, b):
        key = (min(a, b), max(a, b))
        if key not in made:
            t = field[key[0]] / (field[key[0]] - field[key[1]])
            made[key] = len(points) + len(between)
            between.append((*key, t))
        return made[key]

    result = []
    for t in triangles:
        polygon = []
        for i in range(3):
            a, b = t[i], t[(i + 1) % 3]
            if field[a] > 0:
                polygon.append(a)
            if (field[a] > 0) != (field[b] > 0):
                polygon.append(crossing(a, b))
        result += [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]
    added = [points[a] + t * (points[b] - points[a]) for a, b, t in between]
    return result, np.vstack([points, *added]) if added else points, between


def without_slivers(head, kept, allowed):
    """Restores small invisible groups (nostrils); the insides of eyes and mouth are large and stay removed."""
    groups = components(head[allowed & ~kept])
    result = [tuple(t) for t in head[kept]]
    for group in groups:
        if len(group) <= 40:
            result += group
    return max(components(np.array(result)), key=len)


def components(triangles):
    """Connected groups of triangles, joined by shared vertices."""
    parent = {}

    def find(v):
        while parent.setdefault(v, v) != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        return v

    for a, b, c in triangles:
        parent[find(a)] = find(b)
        parent[find(b)] = find(c)
    groups = {}
    for t in triangles:
        groups.setdefault(find(t[0]), []).append(tuple(int(v) for v in t))
    return list(groups.values())


def turn(yaw_deg, pitch_deg):
    """Rotation by yaw about y, then by pitch about x."""
    a, b = np.deg2rad([yaw_deg, pitch_deg])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return about_x @ about_y


def seen_share(points, triangles):
    """Visible share of each triangle's own pixels (by a depth buffer, viewed along -z)."""
    flat = points[:, :2] * PIXELS_PER_MM
    low = flat[triangles].min((0, 1)) - 2
    size = np.ceil(flat[triangles].max((0, 1)) - low).astype(int) + 3
    depth, owner = np.full(size, -np.inf), np.full(size, -1)
    own = np.zeros(len(triangles))
    for k, t in enumerate(triangles):
        p = flat[t] - low
        (u, v), w = (p[1] - p[0], p[2] - p[0]), p[0]
        det = u[0] * v[1] - u[1] * v[0]
        if det <= 1e-9:
            continue
        first, last = np.ceil(p.min(0)).astype(int), np.floor(p.max(0)).astype(int)
        x, y = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1), indexing="ij")
        s = ((x - w[0]) * v[1] - (y - w[1]) * v[0]) / det
        r = ((y - w[1]) * u[0] - (x - w[0]) * u[1]) / det
        inside = (s >= 0) & (r >= 0) & (s + r <= 1)
        z = points[t[0], 2] + s * (points[t[1], 2] - points[t[0], 2]) + r * (points[t[2], 2] - points[t[0], 2])
        own[k] = inside.sum()
        block = np.s_[first[0]:last[0] + 1, first[1]:last[1] + 1]
        nearer = inside & (z > depth[block])
        depth[block][nearer] = z[nearer]
        owner[block][nearer] = k
    front = np.bincount(owner[owner >= 0], minlength=len(triangles))
    return np.where(own > 0, front / np.maximum(own, 1), 0)


def silhouette_rows(points, faces, heights):
    """Where each height cuts the edges of each side: (vertex, vertex, fraction), from the middle outward."""
    edges = sorted({tuple(sorted((f[i], f[(i + 1) % 3]))) for f in faces for i in range(3)})
    rows = {}
    for name, height in heights.items():
        for side, sign in (("right", -1), ("left", 1)):
            row = []
            for a, b in edges:
                ya, yb = points[a, 1] - height, points[b, 1] - height
                if ya * yb < 0 or (ya == 0) != (yb == 0):
                    t = ya / (ya - yb)
                    at = points[a] + t * (points[b] - points[a])
                    # Closer to the middle, nothing becomes outline before the head is in profile.
                    if sign * at[0] > 25.0:
                        row.append((sign * at[0], a, b, t))
            rows[f"{side}_contour_{name}"] = [r[1:] for r in sorted(row)]
    return rows
