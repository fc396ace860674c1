"""Cross-channel prediction of residuals. All floats are float64, in the order written."""

import math

from ..float32 import f32
from .lattice import divided
from .layout import SPAN

CHANNELS = 64
CLASSES = 5
REFERENCES = 3
DECAY = 0.9
KERNEL_WEIGHT = 0.3
LEAST_ENERGY = 10.0
RIDGE = 1.15, 2.0
LEAST_GAIN = 0.02, 0.15
MAX_RESIDUAL = 128000.0
MAX_WEIGHT = 256.0
NONE = (0.0, 0.0, 0.0)
# By class, in the order of the sums: strides 32, 16, 8; 4; 2; 1. Anchors are added immediately.
ROWS = [
    [],
    [32, 16, 48, *range(8, 64, 16)],
    range(4, 64, 8),
    range(2, 64, 4),
    range(1, 64, 2),
]


class References:
    """The reference channels of one channel in one class."""

    def __init__(self):
        self.channels, self.weights, self.signs = [], [], []
        self.used = False


class Weave:
    def __init__(self):
        self.reset()
        self.begin()

    def reset(self):
        zeros = range(CHANNELS)
        # Indexed by class, channel, and earlier channel or itself.
        self.covariances = [[[0.0] * (j + 1) for j in zeros] for _ in range(CLASSES)]
        self.references = [[References() for _ in zeros] for _ in range(CLASSES)]

    def begin(self):
        """Begins a span."""
        self.kernel = [[0.0] * j for j in range(CHANNELS)]
        # By row: the residuals of the channels that have one, in float32.
        self.residuals = [{} for _ in range(SPAN + 1)]
        # Row and channel of each anchor residual.
        self.anchors = []

    def end(self, n):
        """Ends a span: its residuals are added to the averages, which decay a little."""
        for row, channel in self.anchors:
            del self.residuals[row][channel]
        for rows, class_rows in zip(self.covariances, ROWS):
            sums = [[0.0] * (j + 1) for j in range(n)]
            for row in class_rows:
                residuals = self.residuals[row]
                for j, own in residuals.items():
                    for k, other in residuals.items():
                        if k <= j:
                            total = sums[j][k]
                            for a, b in zip(own, other):
                                total = f32(total + f32(a * b))
                            sums[j][k] = total
            for j in range(n):
                rows[j] = [(c + s / 65536.0) * DECAY for c, s in zip(rows[j], sums[j])] + rows[j][j + 1 :]

    def place(self, j, k, distance_mm):
        near = 800.0 / (800.0 + distance_mm)
        self.kernel[j][k] = near * near * near

    def expect(self, references, row):
        """The residual predicted by the references, in units."""
        x = y = z = 0.0
        residuals = self.residuals[row]
        for k, weight in zip(references.channels, references.weights):
            a, b, c = residuals.get(k, NONE)
            x += weight * a
            y += weight * b
            z += weight * c
        return x, y, z

    def learn(self, level_class, j, row, residual):
        x, y, z = residual
        length = math.sqrt(x * x + y * y + z * z)
        if length == 0.0:
            return
        if length > MAX_RESIDUAL:
            x, y, z = (component * (MAX_RESIDUAL / length) for component in residual)
        x, y, z = f32(x), f32(y), f32(z)
        residuals = self.residuals[row]
        residuals[j] = (x, y, z)
        if level_class != 0:
            return
        self.anchors.append((row, j))
        covariances = self.covariances[0][j]
        for k, (a, b, c) in residuals.items():
            if k <= j:
                covariances[k] += (x * a + y * b + z * c) / 65536.0

    def solve(self, j, n):
        """Chooses and weights the references of channel j of n, for every class."""
        for level_class in range(CLASSES):
            self.references[level_class][j] = self.solved(self.covariances[level_class], j, n)

    def solved(self, covariances, j, n):
        energies = 0.0
        for k in range(n):
            energies += covariances[k][k]
        energy = max(energies / n, LEAST_ENERGY) * KERNEL_WEIGHT
        kernel = self.kernel

        def of(a, b):
            if a < b:
                a, b = b, a
            near = 1.0 if a == b else kernel[a][b]
            return covariances[a][b] + energy * near

        own = of(j, j)
        shared = [of(j, k) for k in range(j)]
        inverse = [divided(1.0, of(k, k) * RIDGE[0] + RIDGE[1]) for k in range(j)]
        found, gain = References(), 0.0
        while len(found.channels) < REFERENCES:
            best, best_k = 0.0, None
            for k in range(j):
                if k in found.channels:
                    continue
                left = shared[k]
                for weight, channel in zip(found.weights, found.channels):
                    left -= weight * of(k, channel)
                explained = left * left * inverse[k]
                if explained > best:
                    best, best_k = explained, k
            if best_k is None or best < LEAST_GAIN[0] * own:
                break
            found.channels.append(best_k)
            found.weights = weigh([[of(a, b) for b in found.channels] for a in found.channels],
                                  [shared[k] for k in found.channels])  # fmt: skip
            gain = 0.0
            for weight, k in zip(found.weights, found.channels):
                gain += weight * shared[k]
            gain = divided(gain, own)
        found.signs = [-1.0 if shared[k] < 0.0 else 1.0 for k in found.channels]
        found.used = gain > LEAST_GAIN[1] and all(abs(w) < MAX_WEIGHT for w in found.weights)
        return found


def weigh(matrix, right):
    """Least squares by Gauss-Jordan elimination without pivoting."""
    n = len(right)
    system = [row + [value] for row, value in zip(matrix, right)]
    for i in range(n):
        system[i][i] = system[i][i] * RIDGE[0] + RIDGE[1]
    for i in range(n):
        pivot = system[i][i]
        for k in range(i, n + 1):
            system[i][k] = divided(system[i][k], pivot)
        for other in range(n):
            if other != i:
                factor = system[other][i]
                for k in range(i, n + 1):
                    system[other][k] -= factor * system[i][k]
    return [row[n] for row in system]
