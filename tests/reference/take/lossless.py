"""`lossless`: the columns of each sampled channel, with the histories of the preceding blocks."""

from .columns import History, read_channel
from .cursor import Cursor


class Lossless:
    """The payloads of a group."""

    EXACT = True

    def __init__(self, _tolerance_mm):
        self.reset()

    def reset(self):
        self.histories = [[History() for _ in range(3)] for _ in range(64)]

    def break_off(self):
        """A marker reappears close to the place where it was lost."""

    def decode(self, payload, _shared, channels):
        cursor = Cursor(payload)
        for channel, histories in zip(channels, self.histories):
            if any(channel.present):
                read_channel(cursor, channel, histories)
        cursor.finish()
