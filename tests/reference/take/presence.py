"""Which samples of a group are present: docs/codec.md, "Presence"."""

from .errors import Corrupt
from .range_coder import Bit, RangeDecoder

CHANNELS = 64
LONG = 61
PAGE, PART = 64, 8
# Ages up to these are of classes 0 to 5; LONG is the seventh.
AGES = [1, 2, 4, 8, 20, 60]


def split(first, end, piece):
    """Splits rows into pieces; the last one may be shorter."""
    return [(at, min(end, at + piece)) for at in range(first, end, piece)]


class State:
    """The presence history of a channel up to a stretch."""

    def __init__(self, present, changed=0):
        self.last = 0b1111 if present else 0
        self.age = LONG
        self.changed = changed  # in the block before: 0 no block, 1 no, 2 yes

    def newest(self):
        return self.last & 1

    def age_class(self):
        return sum(self.age > limit for limit in AGES)

    def push(self, present):
        self.age = min(self.age + 1, LONG) if present == self.newest() else 1
        self.last = self.last << 1 & 0b1111 | present


class Presence:
    """Presence of a group from block to block. A new one is in the state after an empty key block."""

    def __init__(self):
        self.reset()
        self.skip()

    def reset(self):
        self.changes = [Bit() for _ in range(3)]
        self.pages = [Bit() for _ in range(2 * 7 * 3)]
        self.parts = [Bit() for _ in range(2 * 7 * 3)]
        self.by_age = [Bit() for _ in range(2 * 7 * 4)]
        self.by_rows = [Bit() for _ in range(16 * 4)]
        self.states = [State(True) for _ in range(CHANNELS)]

    def skip(self):
        """Advances over an empty block."""
        self.states = [State(False, state.changed) for state in self.states]

    def leave_out_from(self, n_channels):
        for i in range(n_channels, CHANNELS):
            self.states[i] = State(False)

    def all_present(self, n_channels, n_rows):
        """Advances over a block without the section."""
        for state in self.states[:n_channels]:
            state.changed = 1 if state.newest() else 2
            for _ in range(min(n_rows, LONG)):
                state.push(1)
        self.leave_out_from(n_channels)

    def read(self, section, n_channels, n_rows):
        """Returns lists of flags, one per channel."""
        coder = RangeDecoder(section)
        out = []
        beside, beside_before = [1] * n_rows, 1
        for state in self.states[:n_channels]:
            was = state.newest()
            rows = self.channel(coder, state, beside, beside_before, n_rows)
            out.append(rows)
            beside, beside_before = rows, was
        coder.finish()
        self.leave_out_from(n_channels)
        if all(map(all, out)):
            raise Corrupt("a presence section of a block that needs none")
        return [[bool(flag) for flag in rows] for rows in out]

    def channel(self, coder, state, beside, before, n_rows):
        was = state.newest()
        changes = coder.bit(self.changes[state.changed])
        state.changed = 1 + changes
        if not changes:
            for _ in range(min(n_rows, LONG)):
                state.push(was)
            return [was] * n_rows
        rows = []
        changed_page = False
        for page in split(0, n_rows, PAGE):
            certain = not changed_page and page[1] == n_rows
            if not self.any(coder, self.pages, state, beside, before, page, certain, rows):
                continue
            changed_page, changed_part = True, False
            for part in split(*page, PART):
                certain = not changed_part and part[1] == page[1]
                if self.any(coder, self.parts, state, beside, before, part, certain, rows):
                    changed_part = True
                    self.rows(coder, state, beside, before, part, rows)
        return rows

    def any(self, coder, bits, state, beside, before, piece, certain, rows):
        """Whether some rows contain a change; rows without one are appended."""
        was, n_rows = state.newest(), piece[1] - piece[0]
        first = beside[piece[0] - 1] if piece[0] else before
        near = beside[piece[0] : piece[1]]
        place = 1 + first if all(row == first for row in near) else 0
        bit = bits[(was * 7 + state.age_class()) * 3 + place]
        if certain or coder.bit(bit):
            return True
        for _ in range(min(n_rows, LONG)):
            state.push(was)
        rows += [was] * n_rows
        return False

    def rows(self, coder, state, beside, before, part, rows):
        """Decodes the rows of a part that contains a change."""
        changed = False
        for row in range(*part):
            near = beside[row]
            neighbour = near << 1 | (near != (beside[row - 1] if row else before))
            by_age = self.by_age[(state.newest() * 7 + state.age_class()) << 2 | neighbour]
            by_rows = self.by_rows[state.last << 2 | neighbour]
            certain = not changed and row + 1 == part[1]
            flips = 1 if certain else coder.mixed(by_age, by_rows)
            changed = changed or flips
            rows.append(state.newest() ^ flips)
            state.push(rows[-1])
