"""The range coder and its adaptive bits: docs/codec.md, "Range coder"."""

from .errors import Corrupt

TOP = 1 << 24
NIMBLE, STEADY = 5, 7
GROWN_UP = 126


class Bit:
    """Two estimates of the probability of `false`, and the number of bits they are based on."""

    __slots__ = ("nimble", "steady", "seen")

    def __init__(self, odds=None):
        """Starts at `odds` of `true` in 1/256, with the weight of 14 bits; None: even odds without any weight."""
        start = 32768 if odds is None else 65535 - (256 * odds + 128)
        self.nimble = self.steady = start
        self.seen = 0 if odds is None else 14

    def probability(self):
        return min(max((self.nimble + self.steady) >> 1, 32), 65504)

    def learn(self, bit):
        age = (self.seen + 2).bit_length() - 1
        nimble, steady = min(age, NIMBLE), min(age, STEADY)
        if bit:
            self.nimble -= self.nimble >> nimble
            self.steady -= self.steady >> steady
        else:
            self.nimble += (65535 - self.nimble) >> nimble
            self.steady += (65535 - self.steady) >> steady
        self.seen = min(self.seen + 1, GROWN_UP)


class RangeDecoder:
    """Reads bytes, and zeros after the end."""

    def __init__(self, data):
        self.data = data
        self.at = 4
        self.code = int.from_bytes((data[:4] + bytes(4))[:4], "big")
        self.range = 0xFFFFFFFF

    def split(self, probability):
        """Decodes a bit that is `false` with this probability in 2^-16."""
        bound = self.range * probability >> 16
        bit = self.code >= bound
        if bit:
            self.code -= bound
            self.range -= bound
        else:
            self.range = bound
        while self.range < TOP:
            self.range <<= 8
            byte = self.data[self.at] if self.at < len(self.data) else 0
            self.code = self.code << 8 | byte
            self.at += 1
        return bit

    def bit(self, model):
        bit = self.split(model.probability())
        model.learn(bit)
        return bit

    def mixed(self, a, b):
        """Decodes a bit with the mixed probability of two models."""
        bit = self.split((a.probability() + b.probability()) >> 1)
        a.learn(bit)
        b.learn(bit)
        return bit

    def plain(self, n):
        """Decodes `n` bits of even odds, highest first."""
        value = 0
        for _ in range(n):
            value = value << 1 | self.split(32768)
        return value

    def finish(self):
        """Checks that every byte was needed."""
        if self.at < len(self.data):
            raise Corrupt("bytes after the coded bits")
