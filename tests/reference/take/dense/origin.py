"""Candidates for the origin of a run."""

from . import layout as ctx
from .track import MEMORY, ZERO

FORGOTTEN_ROWS = 200


class Ways:
    """Candidates: the nearby one (always there) first, then the channel's own end, then ends of other channels."""

    def __init__(self, tracks, channel, at, first_row, present):
        now = first_row + at - MEMORY
        nearby = [track for track in tracks[:channel] if track.known[at]]
        self.points = [nearby[-1].points[at] if nearby else ZERO]
        self.age = None
        end = tracks[channel].end
        if end:
            self.age = now - end.row
            self.points.append(moved(tracks, channel, at, end.point, self.age))
        self.ends = find_ends(tracks, channel, now, first_row, present)
        self.points += [tracks[k].end.point for k in self.ends]

    def read(self, coder, model):
        """The number of the candidate, the contexts of its residual, the channel whose end is used."""
        if self.age is not None:
            age = min(max(self.age, 1).bit_length() - 1, 7)
            if model.single(coder, ctx.ORIGIN_OWN + age):
                return 1, 1, None
        if not self.ends or model.single(coder, ctx.ORIGIN_NONE):
            return 0, 0, None
        rank = 0
        while rank < len(self.ends) - 1 and not model.single(coder, ctx.ORIGIN_RANK + rank):
            rank += 1
        return len(self.points) - len(self.ends) + rank, 2, self.ends[rank]


def find_ends(tracks, channel, now, first_row, present):
    """Channels whose runs ended without a successor: the latest first, at a tie the lower channel."""
    found = []
    for k, flags in enumerate(present):
        end = tracks[k].end
        if end is None or k == channel:
            continue
        next_row = end.row + 1 - first_row
        goes_on = flags is not None and 0 <= next_row < len(flags) and flags[next_row]
        if end.taken or goes_on or end.row >= now or end.row + FORGOTTEN_ROWS <= now:
            continue
        found.append((-end.row, k))
    return [k for _, k in sorted(found)[: ctx.CANDIDATES]]


def moved(tracks, channel, at, point, rows):
    """A point `rows` rows ago, moved as its nearest neighbour at that time has moved since."""
    then = at - rows
    if then < 0:
        return point
    best, found = float("inf"), point
    for k, track in enumerate(tracks):
        if k == channel or not track.known[at] or not track.known[then]:
            continue
        old, new = track.points[then], track.points[at]
        x, y, z = (float(o - p) for o, p in zip(old, point))
        squares = x * x + y * y + z * z
        if squares < best:
            best = squares
            found = tuple(p + n - o for p, n, o in zip(point, new, old))
    return found
