"""Renders textured triangles with a z-buffer."""

import numba
import numpy as np


@numba.njit(cache=True)
def draw(points, depth, uv, shade, triangles, corners, texture, image, nearest, alpha_min):
    """Draws triangles into `image` (height x width x 4, the last is coverage) where they are closer than `nearest`.

    `points` are pixels and `depth` grows away from the camera; `triangles` index both and `shade` (three channels per
    vertex), `corners` index `uv`. Texels with an alpha below `alpha_min` are skipped, the others blended.
    """
    high, wide = nearest.shape
    rows, columns = texture.shape[0], texture.shape[1]
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = points[a, 0], points[a, 1], points[b, 0], points[b, 1], points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        x0, x1 = max(0, int(np.ceil(min(ax, bx, cx)))), min(wide - 1, int(np.floor(max(ax, bx, cx))))
        y0, y1 = max(0, int(np.ceil(min(ay, by, cy)))), min(high - 1, int(np.floor(max(ay, by, cy))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                w = 1 - u - v
                if u < 0 or v < 0 or w < 0:
                    continue
                z = u * depth[a] + v * depth[b] + w * depth[c]
                if z > nearest[y, x]:
                    continue
                s = u * uv[corners[t, 0], 0] + v * uv[corners[t, 1], 0] + w * uv[corners[t, 2], 0]
                r = u * uv[corners[t, 0], 1] + v * uv[corners[t, 1], 1] + w * uv[corners[t, 2], 1]
                column = min(columns - 1, max(0, int((s - np.floor(s)) * columns)))
                row = min(rows - 1, max(0, int((1 - (r - np.floor(r))) * rows)))
                alpha = texture[row, column, 3]
                if alpha < alpha_min:
                    continue
                if alpha > 0.5:
                    nearest[y, x] = z
                for channel in range(3):
                    light = u * shade[a, channel] + v * shade[b, channel] + w * shade[c, channel]
                    image[y, x, channel] += alpha * (texture[row, column, channel] * light - image[y, x, channel])
                image[y, x, 3] = max(image[y, x, 3], alpha)


@numba.njit(cache=True)
def depths(points, depth, triangles, nearest):
    """Writes the smallest depth of each pixel to `nearest`: the shadow map of a lamp."""
    high, wide = nearest.shape
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = points[a, 0], points[a, 1], points[b, 0], points[b, 1], points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        for y in range(max(0, int(np.ceil(min(ay, by, cy)))), min(high - 1, int(np.floor(max(ay, by, cy)))) + 1):
            for x in range(max(0, int(np.ceil(min(ax, bx, cx)))), min(wide - 1, int(np.floor(max(ax, bx, cx)))) + 1):
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                if u >= 0 and v >= 0 and u + v <= 1:
                    nearest[y, x] = min(nearest[y, x], u * depth[a] + v * depth[b] + (1 - u - v) * depth[c])


@numba.njit(cache=True)
def normals(points, triangles):
    """Unit normals of the vertices, means of the adjacent faces weighted by area."""
    out = np.zeros(points.shape)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        n = np.cross(points[b] - points[a], points[c] - points[a])
        out[a] += n
        out[b] += n
        out[c] += n
    for i in range(len(out)):
        out[i] /= np.sqrt((out[i] ** 2).sum()) + 1e-12
    return out
