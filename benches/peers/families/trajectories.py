"""mdz, a compressor of molecular trajectories and the published codec closest to marker data: points over time, an
error bound for each axis, prediction from earlier frames or, with anchors, from both sides.

Its default of 20 frames per group serves random access. The longest groups of its format compress better and are used
here. Only the compressed groups count, not the file header.
"""

import mdz

from families.base import Codec, Way

GROUP_ANCHORS_MAX = 255  # a limit of the format
ANCHOR_STEPS = (1, 2, 4, 8, 16, 32)
ORDERS = (0, 1, 2)  # orders of the predictor; 0 selects one for each group
# The largest error is 4 times the `precision` with adaptive steps, and half of it without.
STEPS = {True: 0.25, False: 2.0}


def group_frames(frames, anchor_step):
    """Frames per group: the fewest equal groups within the limit of anchors."""
    longest = (GROUP_ANCHORS_MAX - 2) * anchor_step
    groups = -(-frames // longest)
    return -(-frames // groups)


def mdz_ways(take):
    mdz.set_num_threads(1)
    markers, frames = len(take.filled) // 3, take.filled.shape[1]
    positions = take.filled.reshape(markers, 3, frames).transpose(2, 0, 1).copy()
    sizes = {group_frames(frames, step) for step in ANCHOR_STEPS[1:]}
    for adaptive in (False, True):
        for step in ANCHOR_STEPS:
            # Without anchors, groups may have any length.
            for size in sizes if step == 1 else {group_frames(frames, step)}:
                for order in ORDERS:
                    name = f"groups of {size}, anchors every {step}, order {order}{', adaptive' * adaptive}"
                    settings = {"gof_size": size, "anchor_step": step, "predictor_order": order, "adaptive": adaptive}
                    yield mdz_way(name, positions, settings)


def mdz_way(name, positions, settings):
    factor = STEPS[settings["adaptive"]]
    return Way(
        name,
        lambda _, tol: mdz.compress(positions, precision=tol * factor, zstd_level=19, codec="temporal", **settings),
        lambda take, trajectory: mdz.decompress(trajectory)[0].transpose(1, 2, 0).reshape(take.filled.shape),
        size=lambda trajectory: trajectory.compressed_size,
    )


def codecs():
    from importlib.metadata import version

    return [Codec("mdz", f"mdz {version('mdz')}", mdz_ways, tuned=True, timed=True)]
