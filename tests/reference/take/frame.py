"""One block: header, presence, payload (docs/codec.md, "The frame")."""

from .cursor import Cursor
from .errors import Corrupt
from .presence import CHANNELS, Presence

ABSENT = (0.0, 0.0, 0.0)


class Channel:
    """The rows of one channel in one block."""

    def __init__(self, present):
        self.present = present
        self.positions = [ABSENT] * len(present)
        self.kept = [False] * len(present)

    def runs(self):
        """Half-open ranges of present rows."""
        row, n_rows = 0, len(self.present)
        while row < n_rows:
            if not self.present[row]:
                row += 1
                continue
            start = row
            while row < n_rows and self.present[row]:
                row += 1
            yield start, row


class Group:
    """The blocks of one group of channels, in order. `payload` decodes the bytes after the frame."""

    def __init__(self, payload, tolerance_mm):
        self.payload = payload
        self.tolerance_mm = tolerance_mm
        self.presence = Presence()
        self.n_channels = 0
        self.stated_mm = 0.0  # of the last block

    def decode(self, block, shared, n_rows, key):
        """Returns the channels of the block; none for an empty one."""
        if key:
            self.payload.reset()
            self.presence.reset()
            self.n_channels = 0
        if not block:
            self.payload.break_off()
            self.presence.skip()
            return []
        if n_rows == 0:
            raise Corrupt("a block with bytes but without rows")
        cursor = Cursor(block)
        head = cursor.byte()
        states_channels = head & 0x40
        if states_channels:
            n = cursor.varint()
            if not self.n_channels < n <= CHANNELS:
                raise Corrupt("a number of channels that cannot be")
            self.n_channels = n
        if self.n_channels == 0:
            raise Corrupt("a first block without its number of channels")
        if head & 0x80:
            section = cursor.take(cursor.varint())
            present = self.presence.read(section, self.n_channels, n_rows)
        else:
            self.presence.all_present(self.n_channels, n_rows)
            present = [[True] * n_rows for _ in range(self.n_channels)]
        channels = [Channel(flags) for flags in present]
        if not any(map(any, present)) or states_channels and not any(present[-1]):
            raise Corrupt("no samples where some must be")
        steps = head & 0x3F
        if steps and self.payload.EXACT:
            raise Corrupt("a lossless block that states an error")
        self.stated_mm = self.tolerance_mm if steps == 63 else self.tolerance_mm * steps / 63
        self.payload.decode(cursor.rest(), shared, channels)
        return channels
