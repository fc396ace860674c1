"""Landmark names, and the vertices of MakeHuman's base mesh hm08 that correspond to them."""

# iBUG-68 point -> vertex of the base mesh. The jaw (0-16) is the silhouette of a frontal view.
LANDMARKS = {
    0: 870, 1: 5186, 2: 5246, 3: 910, 4: 735, 5: 5298, 6: 5295, 7: 5292, 8: 732, 9: 11898, 10: 11901, 11: 11903,
    12: 7455, 13: 7612, 14: 11854, 15: 11798, 16: 7575,
    17: 261, 18: 225, 19: 204, 20: 205, 21: 209, 22: 6984, 23: 6980, 24: 6979, 25: 6999, 26: 7030,
    27: 132, 28: 131, 29: 164, 30: 5054, 31: 325, 32: 313, 33: 317, 34: 7076, 35: 7087,
    36: 21, 37: 0, 38: 54, 39: 69, 40: 47, 41: 41,

    48: 422, 49: 5351, 50: 460, 51: 466, 52: 7219, 53: 11953, 54: 7182, 55: 7235, 56: 7241, 57: 5337, 58: 486, 59: 480,
    62: 474, 66: 493,
}

# The edge of the right eye's lids, in order: the socket lies within it.
LID_RING = (
    0, 1, 54, 57, 60, 102, 63, 66, 69, 72, 53, 5080, 50, 47, 44, 41, 36, 33, 30, 5078, 27, 24, 21, 18, 15, 12, 9, 6,
)

_EYE = ("outer", "top_outer", "top_inner", "inner", "bottom_inner", "bottom_outer")
_EYE_LEFT = ("inner", "top_inner", "top_outer", "outer", "bottom_outer", "bottom_inner")
_MOUTH = ("right", "top_right_outer", "top_right", "top", "top_left", "top_left_outer", "left",
          "bottom_left_outer", "bottom_left", "bottom", "bottom_right", "bottom_right_outer")
_NOSE = ("right", "bottom_right", "bottom", "bottom_left", "left")

# Name -> iBUG-68 point. Right and left are the subject's.
FEATURES = {f"right_brow_{i + 1}": 17 + i for i in range(5)}
FEATURES |= {f"left_brow_{5 - i}": 22 + i for i in range(5)}
FEATURES |= {f"nose_{name}": 31 + i for i, name in enumerate(_NOSE)}
FEATURES |= {f"right_eye_{name}": 36 + i for i, name in enumerate(_EYE)}
FEATURES |= {f"left_eye_{name}": 42 + i for i, name in enumerate(_EYE_LEFT)}
FEATURES |= {f"mouth_{name}": 48 + i for i, name in enumerate(_MOUTH)}
FEATURES |= {"mouth_inner_top": 62, "mouth_inner_bottom": 66}
FEATURES |= {"nasion": 27, "nose_ridge_top": 28, "nose_ridge": 29, "nose_tip": 30, "chin": 8}
FEATURES |= {f"right_jaw_{i + 1}": i for i in range(8)}
FEATURES |= {f"left_jaw_{i + 1}": 16 - i for i in range(8)}


def contour_heights(points, named):
    """The six heights of (Yang et al. 2004) at which the outline of the face is sampled, as y of the model."""
    y = lambda *names: sum(points[named[n], 1] for n in names) / len(names)
    brows, base = y("right_brow_3", "left_brow_3"), y("nose_bottom")
    chin, lip = y("chin"), y("mouth_bottom")
    return {
        # The hairline: forehead, nose and lower face have equal heights (the classical canon).
        "top": brows + 0.9 * (brows - base),
        "brow": brows,
        "eye": y("right_eye_outer", "left_eye_outer"),
        "nose": base,
        "mouth": y("mouth_right", "mouth_left"),
        "chin": (chin + lip) / 2,
    }


def complete(landmarks, ring, mirror):
    """The left eye's landmarks and lid ring: those of the right eye, mirrored."""
    other = {42: 39, 43: 38, 44: 37, 45: 36, 46: 41, 47: 40}
    landmarks |= {left: mirror[landmarks[right]] for left, right in other.items()}
    return ring, tuple(mirror[v] for v in ring)
