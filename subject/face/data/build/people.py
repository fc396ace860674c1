"""MakeHuman's head, random people and random expressions."""

import json

import numpy as np

ETHNIC = ("african", "asian", "caucasian")
GENDERS = ("female", "male")
# Standard deviation of a slider of MakeHuman, which ranges from -1 to 1: with more, random faces look unnatural.
SLIDER_SD = 0.22


class Head:
    """The base mesh, and its morph targets as displacements, in decimetres."""

    def __init__(self, base, targets):
        self.vertices, self.quads = read_base(base)
        self.count, self.between, self.remembered = len(self.vertices), [], {}
        self.archive = np.load(targets, allow_pickle=True)
        self.names = sorted(k[len("targets/"):-len(".index")] for k in self.archive if k.endswith(".index"))

    def add(self, between):
        """Adds vertices that lie between two others and move with them."""
        self.between = between
        self.vertices = self._filled(self.vertices)

    def target(self, name):
        """Displacement of every vertex at full strength."""
        moved = np.zeros((self.count, 3))
        moved[self.archive[f"targets/{name}.index"].astype(int)] = self.archive[f"targets/{name}.vector"] * 1e-3
        return self._filled(moved)

    def target_of(self, kept, name):
        """Displacement of the kept vertices at full strength; cached, because it is used thousands of times."""
        if name not in self.remembered:
            self.remembered[name] = self.target(name)[kept]
        return self.remembered[name]

    def _filled(self, rows):
        rows = list(rows)
        for a, b, t in self.between:
            rows.append(rows[a] + t * (rows[b] - rows[a]))
        return np.array(rows)

    def mean(self):
        """The average of six young adults."""
        macro = [self.target(f"macrodetails/{e}-{g}-young") for e in ETHNIC for g in GENDERS]
        build = [self.target(f"macrodetails/universal-{g}-young-averagemuscle-averageweight") for g in GENDERS]
        return self.vertices + np.mean(macro, axis=0) + np.mean(build, axis=0)




def read_base(path):
    """Vertices and quads of the base mesh."""
    if path.endswith(".json"):
        with open(path, encoding="utf-8") as file:
            mesh = json.load(file)
        # three.js, format 3: a bit mask, four vertices, a material, four texture coordinates.
        faces = np.array(mesh["faces"]).reshape(-1, 10)
        return np.array(mesh["vertices"], float).reshape(-1, 3), faces[:, 1:5]
    vertices, quads = [], []
    with open(path, encoding="utf-8") as file:
        for line in file:
            words = line.split()
            if words[:1] == ["v"]:
                vertices.append([float(w) for w in words[1:4]])
            elif words[:1] == ["f"] and len(words) == 5:
                quads.append([int(w.split("/")[0]) - 1 for w in words[1:]])
    return np.array(vertices), np.array(quads)


def sliders(head, kept):
    """Pairs of opposite displacements of the kept vertices, left and right together."""
    groups = ("head", "eyes", "nose", "mouth", "chin", "cheek", "forehead", "eyebrows")
    moved = {}
    for name in head.names:
        group, _, rest = name.partition("/")
        if group in groups and "angle-in" not in rest and "angle-out" not in rest and "-trans-in" not in rest:
            moved[name] = head.target(name)[kept]
    # Left and right together: a resting face is rarely asymmetric, and asymmetric modes would distort the fit.
    both = {n.replace("/l-", "/"): d + moved[n.replace("/l-", "/r-")] for n, d in moved.items() if "/l-" in n}
    both.update({n: d for n, d in moved.items() if "/l-" not in n and "/r-" not in n})
    opposite = {"decr": "incr", "down": "up", "backward": "forward", "concave": "convex", "in": "out",
                "compress": "uncompress"}
    result, used = [], set()
    for name, moved_by in both.items():
        stem, _, end = name.rpartition("-")
        other = f"{stem}-{opposite.get(end, '?')}"
        if other in both:
            result.append((moved_by, both[other]))
            used |= {name, other}
    result += [(None, d) for n, d in both.items() if n not in used and n.rpartition("-")[2] not in opposite.values()]
    return result


def random_identity(head, kept, pairs, rng):
    """One random adult: a mixture of descent, sex and age, a build, and small random values of all sliders."""
    descent = rng.dirichlet([0.7, 0.7, 0.7])
    male = rng.beta(0.4, 0.4)
    old = rng.beta(0.7, 1.6)
    heavy, thin = max(0.0, w := rng.normal(0, 0.35)), max(0.0, -w)
    shape = head.vertices[kept].copy()
    moved = lambda name: head.target_of(kept, name)
    for sex, share in (("male", male), ("female", 1 - male)):
        for age, part in (("old", old), ("young", 1 - old)):
            for e, name in enumerate(ETHNIC):
                shape += share * part * descent[e] * moved(f"macrodetails/{name}-{sex}-{age}")
            for build, amount in (("averageweight", 1 - heavy - thin), ("maxweight", heavy), ("minweight", thin)):
                name = f"macrodetails/universal-{sex}-{age}-averagemuscle-{build}"
                shape += share * part * amount * moved(name)
    for minus, plus in pairs:
        value = np.clip(rng.normal(0, SLIDER_SD), -1, 1)
        if value > 0:
            shape += value * plus
        elif minus is not None:
            shape -= value * minus
    return shape


def expressions(head, kept):
    """Displacements of the expression units, averaged over descent."""
    units = [n.rpartition("/")[2] for n in head.names if n.startswith("expression/units/caucasian/")]
    wanted = [u for u in units if not u.startswith("neck")]
    return [np.mean([head.target(f"expression/units/{e}/{u}")[kept] for e in ETHNIC], axis=0) for u in wanted]
