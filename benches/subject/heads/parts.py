"""The parts of a head from MakeHuman: skin, eyes, brows, lashes, teeth, hair and beards, with their textures."""

import functools
import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "subject/face/data/build"))
from decimate import mirror_of  # noqa: E402
from features import LANDMARKS, LID_RING, complete  # noqa: E402
from people import Head, expressions, random_identity, sliders  # noqa: E402

BODY = 13380
# Height of the strip of the body that is drawn below the chin, in decimetres.
BUST = 3.4


def triangles_of(quads):
    return np.ascontiguousarray(np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


@functools.cache
def texture(path):
    """Red, green, blue and alpha, 0 to 1."""
    return np.asarray(Image.open(path).convert("RGBA"), np.float32) / 255


class Part:
    """A mesh attached to the base mesh, and its textures."""

    def __init__(self, folder):
        path = next(p for p in sorted(folder.glob("*.json")) if p.stem == folder.name)
        mesh = json.loads(path.read_text())
        faces = np.array(mesh["faces"]).reshape(-1, 10)
        self.triangles, self.corners = triangles_of(faces[:, 1:5]), triangles_of(faces[:, 6:10])
        self.uv = np.array(mesh["uvs"][0], float).reshape(-1, 2)
        self.refs, self.weights = np.array(mesh["ref_vIdxs"]), np.array(mesh["weights"])
        self.offsets = np.array(mesh["offsets"])
        self.textures = sorted((folder / "textures").glob("*.png"))
        self.name = folder.name

    def on(self, base, scale):
        """Its vertices on a person; `scale` is the size of the head relative to the base mesh, for three axes."""
        return (base[self.refs] * self.weights[:, :, None]).sum(1) + self.offsets * scale


class Parts:
    """All parts, with the base mesh and its morph targets."""

    def __init__(self, data, targets):
        base = data / "models/human_full_size.json"
        mesh = json.loads(base.read_text())
        faces = np.array(mesh["faces"]).reshape(-1, 10)
        skin = faces[(faces[:, 5] == 0)]
        self.head = Head(str(base), str(targets))
        self.uv = np.array(mesh["uvs"][0], float).reshape(-1, 2)
        complete(LANDMARKS, LID_RING, mirror_of(self.head.vertices, [tuple(q) for q in skin[:, 1:5]]))
        self.mean = self.head.mean()
        self.chin = self.mean[LANDMARKS[8], 1]
        near = self.mean[skin[:, 1:5], 1].min(1) > self.chin - BUST
        self.triangles, self.corners = triangles_of(skin[near][:, 1:5]), triangles_of(skin[near][:, 6:10])
        self.kept = np.arange(len(self.mean))
        self.sliders = sliders(self.head, self.kept)
        self.expressions = expressions(self.head, self.kept)
        proxies = data / "proxies"
        all_of = lambda kind, but=(): [Part(p) for p in sorted((proxies / kind).iterdir()) if p.name not in but]
        beards = ("Full_beard", "Moustache")
        self.hair = all_of("hair", beards)
        self.beards = [Part(proxies / "hair" / name) for name in beards]
        # Modelled hair by hair, these have ten times the triangles of the others without visible effect.
        self.brows = all_of("eyebrows", ("Eyebrows_01",))
        self.lashes = all_of("eyelashes", ("Eyelashes_01",))
        self.eyes = [Part(proxies / "eyes/Low-Poly")]
        self.teeth = [Part(proxies / "teeth/Teeth_Base")]
        self.skins = sorted(p for p in (data / "skins").glob("*/textures/*.png") if "toon" not in str(p))

    def size(self, base):
        """Width, height and depth of a head."""
        at = base[[LANDMARKS[i] for i in (0, 16, 8, 27, 30)]]
        return np.array([at[1, 0] - at[0, 0], at[3, 1] - at[2, 1], at[4, 2] - at[0, 2]])
