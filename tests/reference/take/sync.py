"""`sync`: splines of all channels with common key times (docs/codec.md, "sync")."""

from .cursor import Cursor
from .errors import Corrupt
from .spline import Spline


class Sync(Spline):
    def begin(self, shared, n_rows):
        self.keys = set()
        cursor = Cursor(shared)
        row = -1
        while cursor.left():
            row += 1 + cursor.varint()
            if row >= n_rows:
                raise Corrupt("a key time beyond the block's rows")
            self.keys.add(row)

    def knots(self, _cursor, start, end):
        last = end - start - 1
        inner = [row for row in range(1, last) if start + row in self.keys]
        return [0] + inner + ([last] if last else [])
