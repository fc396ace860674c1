"""Prediction of a span's last row by seven extrapolations."""

# Number of rows over which the velocity is measured, and its weight in quarters.
GUESSES = [(1, 0), (2, 4), (4, 4), (8, 4), (8, 2), (32, 4), (32, 2)]
MAX_ERROR = 1 << 24


class Anchor:
    def __init__(self):
        self.errors = [[0] * len(GUESSES) for _ in range(3)]

    def guess(self, known, m):
        """`known`: the points of the run up to row 0. Returns the best prediction of row m, and all by axis."""
        last, n_before = known[-1], len(known) - 1
        best, guesses = [], []
        for axis in range(3):
            row = []
            for window, quarters in GUESSES:
                window = min(window, n_before)
                guess = last[axis]
                if window > 0:
                    travelled = last[axis] - known[n_before - window][axis]
                    guess += travelled * m * quarters // (4 * window)
                row.append(guess)
            errors = self.errors[axis]
            best.append(row[errors.index(min(errors))])
            guesses.append(row)
        return best, guesses

    def score(self, guesses, point):
        for errors, row, coordinate in zip(self.errors, guesses, point):
            for i, guess in enumerate(row):
                off = min(abs(guess - coordinate), MAX_ERROR)
                errors[i] += off - errors[i] // 8
