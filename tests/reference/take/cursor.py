"""Sequential reading of bytes."""

from .errors import Corrupt


class Cursor:
    """A chunk or a part of it."""

    def __init__(self, data):
        self.data = data
        self.at = 0

    def left(self):
        return len(self.data) - self.at

    def take(self, n):
        if n > self.left():
            raise Corrupt("cut short")
        self.at += n
        return self.data[self.at - n : self.at]

    def byte(self):
        return self.take(1)[0]

    def varint(self):
        """LEB128: seven bits per byte, lowest first, the high bit set on all but the last byte."""
        value = shift = 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        if value >> 64 or shift > 70:
            raise Corrupt("a varint of more than 64 bits")
        if byte == 0 and shift > 7:
            raise Corrupt("a varint longer than it needs to be")
        return value

    def rest(self):
        return self.take(self.left())

    def finish(self):
        if self.left():
            raise Corrupt("bytes are left over")
