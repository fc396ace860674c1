"""Reads takes of mocapd into NumPy arrays, and writes arrays as takes.

>>> import mocapd
>>> take = mocapd.open("jump.take")
>>> take.positions.shape            # frames, markers, axes; millimetres, NaN where a marker was not seen
(1200, 15, 3)
>>> take["LKNE"].read(start_s=2.0, stop_s=3.0)      # one second of one marker

Positions are float32 millimetres, right-handed, in the axes of the device or the imported file. Every sample is within
``take.header.tolerance_mm`` of the recorded one (Euclidean distance in 3D): the encoder verified each of them.
"""

from importlib.metadata import version

from ._arrays import compress, decompress, write_take
from ._native import TakeError
from ._records import ClockLine, Device, Ending, Event, Header, Ledger, LostFrames, Source, Times
from ._take import Marker, MarkerSummary, Take, TakeWarning, open

__version__ = version("mocapd")

__all__ = [
    "ClockLine",
    "Device",
    "Ending",
    "Event",
    "Header",
    "Ledger",
    "LostFrames",
    "Marker",
    "MarkerSummary",
    "Source",
    "Take",
    "TakeError",
    "TakeWarning",
    "Times",
    "compress",
    "decompress",
    "open",
    "write_take",
]
