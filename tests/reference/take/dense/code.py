"""One row with a prediction: its references, its partners, its residual."""

from ..errors import Corrupt
from . import row as syntax
from .lattice import CENTRED, CUBIC, MAX_DECODED, UNITS, distance, nearest, wrap
from .lengths import LEAST_SHARE, Lengths, along
from .model import Model
from .track import ZERO, Track, magnitude
from .weave import Weave

CHANNELS = 64
# By kind: anchors; strides 1, 2, 4; 8 and more.
CLASS = [0, 0, 0, 0, 4, 3, 2, 1, 1, 1]
# Kinds whose partners are evaluated at one place: strides 1, 2 and 4.
FINE = range(4, 7)


class Rows:
    """The adaptive state of a group of channels, and the decoding of a row with it."""

    def __init__(self):
        self.tracks = [Track() for _ in range(CHANNELS)]
        self.model = Model()
        self.weave = Weave()
        self.lengths = Lengths()
        # State of the current block and span.
        self.coder = self.settled = None
        self.before = 0

    def reset(self):
        for track in self.tracks:
            track.reset()
        self.model.reset()
        self.weave.reset()
        self.lengths.reset()

    def code(self, channel, at, expected, around, left, right, shares):
        """Decodes one row with a prediction: its references, its partners with their shares, its residual."""
        kind, row = around.kind, at - self.before
        references = self.weave.references[CLASS[kind]][channel]
        self.refer(around, references, channel, at, row)
        prediction = list(expected)
        if references.used:
            off = self.weave.expect(references, row)
            prediction = [wrap(e + nearest(o)) for e, o in zip(expected, off)]
        pulls = self.pull(channel, kind, prediction, shares, (left, at, right))

        track = self.tracks[channel]
        lattice = CENTRED if track.activity[kind] >= 256 else CUBIC
        coded = syntax.residual(self.coder, self.model, track, around, lattice == CENTRED)
        magnitudes, point = ZERO, tuple(prediction)
        if coded:
            steps, magnitudes = coded
            step = track.fineness[lattice]
            point = tuple(p + s * step for p, s in zip(prediction, steps))
        self.settle(channel, at, kind, point, magnitudes, coded is not None)

        if coded:
            for pull in pulls:
                self.lengths.score(channel, kind, pull, point)
        residual = [float(p - e) for p, e in zip(point, expected)]
        self.weave.learn(CLASS[kind], channel, row, residual)
        if CLASS[kind] <= 1:
            for k in self.lengths.near[channel]:
                other = self.tracks[k]
                length = self.length(channel, k, left, at, right)
                if length is not None and other.known[at]:
                    self.lengths.learn(channel, k, distance(point, other.points[at]), length)

    def refer(self, around, references, channel, at, row):
        """The residuals of the references in a row."""
        if not references.channels:
            if channel > 0 and self.tracks[channel - 1].known[at]:
                steps = self.tracks[channel - 1].steps[at]
                around.references = [2 * magnitude(step) for step in steps]
            return
        sums, sides = [0, 0, 0], [0.0, 0.0, 0.0]
        residuals = self.weave.residuals[row]
        for k, sign in zip(references.channels, references.signs):
            track = self.tracks[k]
            if track.known[at] and track.steps[at] != ZERO:
                for axis, step in enumerate(track.steps[at]):
                    sums[axis] += magnitude(step)
            if k in residuals:
                for axis, component in enumerate(residuals[k]):
                    sides[axis] += component * sign
        around.references = sums
        around.references_side = [1 if s >= 30.0 else 2 if s <= -30.0 else 0 for s in sides]

    def length(self, channel, k, left, at, right):
        """The expected distance of two channels in a row, in tolerances; None if it is unknown."""
        own, other = self.tracks[channel], self.tracks[k]
        for row in (left, right):
            if not (own.known[row] and other.known[row]):
                return None
        first = distance(own.points[left], other.points[left])
        if left == right:
            return first
        return along(first, distance(own.points[right], other.points[right]), left, at, right)

    def pull(self, channel, kind, prediction, shares, rows):
        """Moves the prediction to satisfy the distances to the partners, one after another."""
        pulls, far = [], kind not in FINE
        start, moved = [float(units) for units in prediction], [0.0, 0.0, 0.0]
        seen = start
        for slot, k in enumerate(self.lengths.partners[channel]):
            left, at, right = rows
            if not self.tracks[k].known[at]:
                continue
            length = self.length(channel, k, left, at, right)
            if length is None:
                continue
            own = [s + m for s, m in zip(start, moved)] if far else start
            aim = self.lengths.aim(own, self.tracks[k].points[at], length)
            if not aim:
                continue
            difference, away = aim
            if not far:
                along = moved[0] * away[0] + moved[1] * away[1] + moved[2] * away[2]
                difference += along / UNITS
            share = shares[slot] if shares[slot] > LEAST_SHARE else 0.0
            by = share * difference * UNITS
            pulls.append((slot, difference, away, seen))
            moved = [m - by * a for m, a in zip(moved, away)]
            seen = [s - by * a for s, a in zip(seen, away)]
        prediction[:] = [nearest(s + m) for s, m in zip(start, moved)]
        return pulls

    def settle(self, channel, at, kind, point, magnitudes, kept):
        if max(map(abs, point)) > MAX_DECODED:
            raise Corrupt("a position beyond every coordinate")
        self.tracks[channel].settle(at, kind, point, magnitudes)
        self.settled(channel, at, point, kept)
