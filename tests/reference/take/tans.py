"""The symbols of `fast`: sixteen fixed tANS tables (docs/codec.md, "fast", "Symbols")."""

from .errors import Corrupt

LOG_STATES = 10
STATES = 1 << LOG_STATES
CLASSES = 14
QUIET, WAKE = CLASSES, CLASSES + 1
QUIET_ROWS = 16
LARGER = 3

# By the number of larger axes and the number of axes that are +-1: 0 larger with 0 to 3, 1 larger with 0 to 2, ...
FREQUENCIES = [
    [937, 5, 1, 1, 1, 1, 1, 1, 1, 1],
    [925, 7, 1, 1, 1, 1, 1, 1, 1, 1],
    [907, 10, 1, 1, 1, 1, 1, 1, 1, 1],
    [868, 14, 2, 1, 2, 1, 1, 1, 1, 1],
    [799, 21, 4, 1, 3, 1, 1, 1, 1, 1],
    [684, 28, 7, 2, 7, 2, 1, 2, 1, 3],
    [495, 30, 11, 4, 12, 5, 3, 6, 4, 11],
    [281, 22, 12, 6, 20, 10, 6, 18, 12, 41],
    [147, 13, 7, 4, 19, 12, 8, 34, 25, 134],
    [73, 6, 4, 2, 14, 9, 6, 44, 33, 299],
    [51, 3, 2, 1, 8, 6, 4, 37, 32, 476],
    [42, 2, 1, 1, 5, 3, 3, 32, 28, 599],
    [102, 9, 3, 2, 12, 8, 4, 37, 29, 351],
    [132, 16, 4, 2, 17, 8, 4, 31, 21, 318],
]
QUIET_FREQUENCIES = [17, 16, 15, 11, 13, 11, 10, 11, 10, 9, 9, 7, 6, 6, 6, 5, 862]
WAKE_FREQUENCIES = [0, 120, 18, 2, 7, 2, 1, 1, 1, 6]


def axes_of(symbol):
    """Codes of x, y, z: 0, +1, -1, larger."""
    return [symbol >> 4 & 3, symbol >> 2 & 3, symbol & 3]


def frequency(table, symbol):
    if table == QUIET:
        return QUIET_FREQUENCIES[symbol] if symbol <= QUIET_ROWS else 0
    axes = axes_of(symbol)
    larger = axes.count(LARGER)
    ones = axes.count(1) + axes.count(2)
    kind = [0, 4, 7, 9][larger] + ones
    return (WAKE_FREQUENCIES if table == WAKE else FREQUENCIES[table])[kind]


def build(table):
    """(symbol, bits, base) of each state."""
    counts = [frequency(table, symbol) for symbol in range(64)]
    spread = [0] * STATES
    place = 0
    for symbol, count in enumerate(counts):
        for _ in range(count):
            spread[place] = symbol
            place = (place + STATES // 2 + STATES // 8 + 3) % STATES
    entries = []
    nexts = counts[:]
    for symbol in spread:
        x = nexts[symbol]
        nexts[symbol] += 1
        bits = LOG_STATES - (x.bit_length() - 1)
        entries.append((symbol, bits, (x << bits) - STATES))
    return entries


TABLES = [build(table) for table in range(CLASSES + 2)]


class Bits:
    """The bits of a payload, from the last to the first."""

    def __init__(self, payload):
        if not payload or payload[-1] == 0:
            raise Corrupt("no end mark")
        self.value = int.from_bytes(payload, "little")
        self.left = self.value.bit_length() - 1
        self.state = 0

    def take(self, n):
        self.left -= n
        if self.left < 0:
            raise Corrupt("cut short")
        return self.value >> self.left & ((1 << n) - 1)

    def symbol(self, table):
        symbol, bits, base = TABLES[table][self.state]
        self.state = base + self.take(bits)
        return symbol

    def larger(self, order):
        zeros = 0
        while self.take(1) == 0:
            zeros += 1
            if zeros > 22:
                raise Corrupt("a residual too large")
        code = 1 << (zeros + order) | self.take(zeros + order)
        magnitude = code - (1 << order) + 2
        return -magnitude if self.take(1) else magnitude
