"""Random people: shape, expression, skin, eyes, hair and accessories."""

import numpy as np

from parts import LANDMARKS, random_identity, texture
from raster import normals
from worn import worn

# Index of the layer of the eyes.
EYES = 3


class Person:
    """Layers of triangles with textures in head coordinates (decimetres, y up, z to the front), far ones first."""

    def __init__(self, parts, random, hard=False):
        base = random_identity(parts.head, parts.kept, parts.sliders, random)
        amounts = random.uniform(-0.1, 0.9, len(parts.expressions)) * (random.random(len(parts.expressions)) < 0.12)
        if random.random() < 0.3:
            amounts *= 0
        for amount, unit in zip(amounts, parts.expressions):
            if amount:
                base = base + amount * unit
        self.base, self.layers = base, []
        self.scale = parts.size(base) / parts.size(parts.head.vertices)
        pick = lambda these: these[random.integers(len(these))]
        skin = self.skin(texture(pick(parts.skins)), random)
        self.add(base, parts.triangles, parts.uv, parts.corners, skin, 0.0)
        self.bust(parts, random)
        self.part(pick(parts.teeth), random, lambda t: t, 0.3)
        self.part(pick(parts.eyes), random, lambda t: t, 0.0)
        hair = self.hair_colour(random)
        tint = lambda t: self.tinted(t, hair)
        self.part(pick(parts.brows), random, tint, 0.15)
        if random.random() < 0.6:
            self.part(pick(parts.lashes), random, lambda t: t * [0.4, 0.4, 0.4, 0.6], 0.15)
        if random.random() < 0.3:
            for beard in parts.beards if random.random() < 0.6 else [pick(parts.beards)]:
                self.part(beard, random, tint, 0.15)
        if hard:
            worn(self, parts, random, hair)
        if random.random() < 0.88:
            self.part(pick(parts.hair), random, tint, 0.3)
        if random.random() < 0.22:
            self.glasses(random)

    def add(self, points, triangles, uv, corners, picture, alpha_min):
        self.layers.append((points, triangles, uv, corners, np.ascontiguousarray(picture, np.float32), alpha_min))

    def part(self, part, random, tint, alpha_min):
        picture = texture(part.textures[random.integers(len(part.textures))])
        self.add(part.on(self.base, self.scale), part.triangles, part.uv, part.corners, tint(picture), alpha_min)

    def skin(self, picture, random):
        """Varies shade and hue of the eighteen textures, which include stubble and make-up."""
        gamma = np.exp(random.normal(0, 0.25)) * np.exp(random.normal(0, 0.05, 3))
        picture = picture.copy()
        picture[..., :3] = picture[..., :3] ** gamma
        return picture

    def hair_colour(self, random):
        kinds = [(0.08, 0.06, 0.05), (0.22, 0.13, 0.08), (0.4, 0.25, 0.14), (0.7, 0.55, 0.33), (0.45, 0.18, 0.08), (0.7, 0.7, 0.7)]
        share = [0.34, 0.24, 0.14, 0.12, 0.05, 0.11]
        return np.array(kinds[random.choice(6, p=share)]) * np.exp(random.normal(0, 0.2))

    def tinted(self, picture, colour):
        """The texture with its strands in another colour."""
        picture = picture.copy()
        there = picture[..., 3] > 0.3
        luma = picture[..., :3] @ [0.3, 0.59, 0.11]
        mean = luma[there].mean() if there.any() else 0.5
        picture[..., :3] = (np.clip(luma / (mean + 1e-3), 0.3, 2.5) ** 0.8)[..., None] * colour
        return picture

    def bust(self, parts, random):
        """Cloth below the collar: the vertices of the skin, slightly offset, with a striped or plain texture."""
        collar = self.base[LANDMARKS[8], 1] - random.uniform(0.45, 1.1)
        triangles = parts.triangles[(self.base[parts.triangles, 1].max(1) < collar)]
        out = self.base + 0.06 * normals(self.base, parts.triangles)
        stripes = 0.5 + 0.5 * np.sign(np.sin(np.arange(64) * random.uniform(0.1, 1.5)))
        colours = random.random((2, 3)) ** 1.3
        cloth = colours[0] + (stripes[:, None] if random.random() < 0.4 else np.zeros((64, 1))) * (colours[1] - colours[0])
        cloth = np.repeat(np.c_[cloth, np.ones(64)][:, None], 64, 1)
        self.add(out, triangles, out[:, :2].copy() / 3, triangles, cloth, 0.0)

    def glasses(self, random):
        """Rims around both eyes, and sometimes tinted glass."""
        right, left = self.base[[LANDMARKS[i] for i in range(36, 42)]].mean(0), self.base[[LANDMARKS[i] for i in range(42, 48)]].mean(0)
        wide, high = random.uniform(0.24, 0.33), random.uniform(0.17, 0.3)
        rim, corner = random.uniform(0.012, 0.05), random.uniform(2, 5)
        angle = np.linspace(0, 2 * np.pi, 41)[:-1]
        power = lambda a: np.sign(a) * np.abs(a) ** (2 / corner)
        x, y = power(np.cos(angle)), power(np.sin(angle))
        front = max(right[2], left[2]) + random.uniform(0.2, 0.3)
        points, triangles = [], []
        for eye in (right, left):
            start = len(points)
            for w in (1.0, 1.0 + rim / wide):
                points += [(eye[0] + wide * w * a, eye[1] - 0.03 + high * w * b, front - 0.15 * (a * np.sign(eye[0])) ** 2 * 0.5) for a, b in zip(x, y)]
            for i in range(40):
                j = (i + 1) % 40
                triangles += [(start + i, start + j, start + 40 + i), (start + j, start + 40 + j, start + 40 + i)]
        start = len(points)
        inner = [right[0] + wide, left[0] - wide]
        points += [(inner[0], right[1], front), (inner[1], left[1], front), (inner[0], right[1] + rim * 1.5, front), (inner[1], left[1] + rim * 1.5, front)]
        triangles += [(start, start + 1, start + 2), (start + 1, start + 3, start + 2)]
        for eye, side in ((right, -1), (left, 1)):
            start = len(points)
            outer = eye[0] + side * wide
            points += [(outer, eye[1], front - 0.07), (outer + side * 0.12, eye[1], front - 1.2), (outer, eye[1] + rim * 1.5, front - 0.07), (outer + side * 0.12, eye[1] + rim * 1.5, front - 1.2)]
            triangles += [(start, start + 1, start + 2), (start + 1, start + 3, start + 2)]
        colour = random.random(3) * 0.25 if random.random() < 0.8 else random.random(3)
        picture = np.ones((2, 2, 4)) * [*colour, 1]
        triangles = np.array(triangles)
        self.add(np.array(points), triangles, np.zeros((len(points), 2)), triangles, picture, 0.0)
