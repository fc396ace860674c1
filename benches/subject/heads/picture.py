"""The simulated photograph of a person: pose, light with shadows, and the effects of the camera."""

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates, zoom

from parts import LANDMARKS
from person import EYES
from raster import depths, draw, normals

# Supersampling: rendered pixels per pixel of the picture, along each axis.
FINER = 2
SHADOW_PX, SHADOW_SLACK = 160, 0.12
# A surface hides an eye when it is this much closer to the camera, in decimetres: more than lids, lashes and glasses are.
HAIR_BEFORE = 0.15


def turned(yaw, pitch, roll):
    """Rotation matrix from degrees: yaw to the right of the picture, pitch downwards, roll clockwise."""
    (sy, cy), (sp, cp), (sr, cr) = ((np.sin(a), np.cos(a)) for a in np.radians((yaw, pitch, roll)))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, sr, 0], [-sr, cr, 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def shades(layers, random, hard):
    """Light of each layer's vertices: ambient (second-order harmonics of the sky), one or two lamps, their shadows."""
    around = random.uniform(0.15, 0.7) if hard else random.uniform(0.25, 0.9)
    slope = random.normal(0, 0.35, 3) + [0, 0.25, 0.1]
    bend = random.normal(0, 0.12, (3, 3))
    lamps = []
    for _ in range(1 + (random.random() < 0.35)):
        way = np.array([random.normal(0, 1.2 if hard else 0.9), random.normal(0.5, 0.6), random.uniform(0.3, 1.3)])
        lamps.append((way / np.linalg.norm(way), random.uniform(0.2, 1.1), np.exp(random.normal(0, 0.07, 3))))
    solid = np.vstack([layer[0][layer[1]].reshape(-1, 3) for layer in layers if layer[5] < 0.1 or layer[5] > 0.25])
    out = []
    for lamp in lamps:
        lamp_x = np.cross([0, 1, 0.01], lamp[0])
        lamp_x /= np.linalg.norm(lamp_x)
        view = np.array([lamp_x, np.cross(lamp[0], lamp_x), -lamp[0]])
        seen = solid @ view.T
        low, size = seen[:, :2].min(0), np.ptp(seen[:, :2], axis=0).max() / SHADOW_PX
        nearest = np.full((SHADOW_PX + 1, SHADOW_PX + 1), np.inf)
        depths((seen[:, :2] - low) / size, seen[:, 2], np.arange(len(seen)).reshape(-1, 3), nearest)
        lit = []
        for layer in layers:
            at = layer[0] @ view.T
            place = np.clip(((at[:, :2] - low) / size).round().astype(int), 1, SHADOW_PX - 1)
            hidden = sum((nearest[place[:, 1] + dy, place[:, 0] + dx] < at[:, 2] - SHADOW_SLACK).astype(float)
                         for dy in (-1, 0, 1) for dx in (-1, 0, 1)) / 9
            # The lids touch the eyeballs: their full shadow would cover the eye.
            lit.append(1 - (0.3 if layer is layers[EYES] else 0.85) * hidden)
        out.append(lit)
    result = []
    gloss = random.uniform(0, 0.35)
    for i, layer in enumerate(layers):
        n = normals(layer[0], layer[1])
        n = np.where(n[:, 2:] < -0.2, -n, n) if layer[5] else n
        sky = around * np.clip(1 + n @ slope + ((n @ bend) * n).sum(1), 0.25, 2)
        light = np.repeat(sky[:, None], 3, 1)
        for lamp, lit in zip(lamps, out):
            facing = np.clip(n @ lamp[0], 0, None)
            half = lamp[0] + [0, 0, 1]
            shine = gloss * np.clip(n @ (half / np.linalg.norm(half)), 0, None) ** 14
            light += (lit[i] * lamp[1] * (facing + shine))[:, None] * lamp[2]
        result.append(light)
    return result


def photograph(person, background, io_px, at, pose, random, hard=False):
    """The picture (floats, 0 to 1) and its face. `at` is the position of the midpoint of the eyes."""
    high, wide = background.shape[:2]
    way = turned(*pose)
    eyes = person.base[[LANDMARKS[i] for i in range(36, 48)]].mean(0)
    layers = [((points - eyes) @ way.T, *rest) for points, *rest in person.layers]
    marks = (person.base - eyes) @ way.T
    apart = np.linalg.norm(person.base[LANDMARKS[36]] - person.base[LANDMARKS[45]])
    away = random.uniform(5, 25)
    project = lambda points: points[:, :2] * [1, -1] * (FINER * io_px / apart) * (away / (away - points[:, 2:])) + FINER * (np.array(at) + 0.5) - 0.5
    image = np.zeros((FINER * high, FINER * wide, 4), np.float32)
    image[..., :3] = np.repeat(np.repeat(background, FINER, 0), FINER, 1)
    nearest = np.full(image.shape[:2], np.inf)
    for (points, triangles, uv, corners, texture, alpha_min), light in zip(layers, shades(layers, random, hard)):
        step = max(1, int(np.sqrt(texture.shape[0] * 0.7 / (FINER * io_px)))) if alpha_min == 0 else 1
        texture = np.ascontiguousarray(texture[::step, ::step])
        draw(project(points), -points[:, 2], uv, light, triangles, corners, texture, image, nearest, max(alpha_min, 0.02))
    # On the inner edges of the lips, only the middle points have landmarks.
    points = marks[[LANDMARKS.get(i, LANDMARKS[27]) for i in range(68)]]
    column, row = np.clip(project(points).round().astype(int), 0, [[FINER * wide - 1, FINER * high - 1]]).T
    visible = (nearest[row, column] > -points[:, 2] - HAIR_BEFORE) & [i in LANDMARKS for i in range(68)]
    shown = []
    for eye in (range(36, 42), range(42, 48)):
        lids = marks[[LANDMARKS[i] for i in eye]].mean(0)
        x, y = np.clip(project(lids[None])[0].round().astype(int), 0, [FINER * wide - 1, FINER * high - 1])
        shown.append(bool(nearest[y, x] > -lids[2] - HAIR_BEFORE))
    image = image.reshape(high, FINER, wide, FINER, 4).mean((1, 3))
    landmarks = (project(marks) + 0.5) / FINER - 0.5
    mean = lambda a, b: landmarks[[LANDMARKS[i] for i in range(a, b)]].mean(0)
    a, b = landmarks[[LANDMARKS[36], LANDMARKS[45]]]
    face = {"points": [mean(36, 42), mean(42, 48), mean(48, 60)], "io": float(np.hypot(*(b - a))), "yaw": float(pose[0]), "shown": shown,
            "landmarks": (project(points) + 0.5) / FINER - 0.5, "visible": visible.tolist(), "pose_deg": [pose[1], pose[0], pose[2]]}
    return image[..., :3], face


def developed(image, random, hard=False):
    """Exposure, tone curve, coloured light, grey, blur, noise and JPEG: 8-bit pixels."""
    image = np.clip(image, 0, None)
    if hard and random.random() < 0.4:
        image = sorely(image, random)
    bright = np.percentile(image, 97)
    image = image * (random.uniform(0.75, 1.1) / max(bright, 0.05) if random.random() < 0.8 else 1)
    image = np.clip(image, 0, 1) ** np.exp(random.normal(0, 0.25))
    kind = random.random()
    if kind < 0.22:
        image = np.repeat((image @ [0.299, 0.587, 0.114])[..., None], 3, 2)
    elif kind < 0.6:
        warm = random.normal(0, 0.12)
        image = image * np.exp([warm, random.normal(0, 0.04), -warm])
    blur = random.choice([0, 0.4, 0.7, 1.1], p=[0.4, 0.3, 0.2, 0.1])
    image = gaussian_filter(image, (blur, blur, 0)) if blur else image
    noise = random.choice([0.004, 0.015, 0.03], p=[0.5, 0.35, 0.15])
    image = image + random.normal(0, noise, image.shape[:2] + ((1,) if random.random() < 0.5 else (3,)))
    picture = Image.fromarray((255 * np.clip(image, 0, 1)).astype("uint8"))
    if random.random() < 0.6:
        file = io.BytesIO()
        picture.save(file, "JPEG", quality=int(random.uniform(40, 95)))
        picture = Image.open(io.BytesIO(file.getvalue())).convert("RGB")
    return picture


def sorely(image, random):
    """Underexposed, overexposed or with motion blur, as in photographs taken indoors."""
    kind = random.random()
    if kind < 0.5:
        return image * random.uniform(0.2, 0.6)
    if kind < 0.7:
        return image * random.uniform(1.3, 2.2)
    far, angle = random.uniform(0.5, 1.3), random.uniform(0, np.pi)
    return gaussian_filter(image, (far * abs(np.sin(angle)), far * abs(np.cos(angle)), 0))


def clutter(wide, high, pictures, random):
    """A background: a crop of a picture without faces, or blobs and edges of random colours."""
    if random.random() < 0.72:
        picture = pictures[random.integers(len(pictures))]
        scale = np.exp(random.uniform(np.log(0.35), np.log(1.6)))
        scale = min(scale, (min(picture.shape[0] / high, picture.shape[1] / wide)))
        h, w = max(2, int(high * scale)), max(2, int(wide * scale))
        y, x = random.integers(picture.shape[0] - h + 1), random.integers(picture.shape[1] - w + 1)
        piece = picture[y : y + h, x : x + w]
        piece = piece[:, ::-1] if random.random() < 0.5 else piece
        at = np.mgrid[0:high, 0:wide].astype(float) * np.array([(h - 1) / high, (w - 1) / wide])[:, None, None]
        out = np.stack([map_coordinates(piece[..., c], at, order=1) for c in range(3)], -1)
        return np.clip(out[..., random.permutation(3)] if random.random() < 0.3 else out, 0, 1) ** np.exp(random.normal(0, 0.3))
    out = np.ones((high, wide, 3)) * random.random(3)
    for _ in range(random.integers(1, 5)):
        cells = int(np.exp(random.uniform(0.7, 3)))
        coarse = random.random((cells + 2, cells + 2, 3)) - 0.5
        fine = np.stack([zoom(coarse[..., c], (high / (cells + 2), wide / (cells + 2)), order=random.integers(0, 2))[:high, :wide] for c in range(3)], -1)
        fine = np.pad(fine, ((0, high - fine.shape[0]), (0, wide - fine.shape[1]), (0, 0)), mode="edge")
        out += random.uniform(0.1, 0.6) * fine
    return np.clip(out, 0, 1)
