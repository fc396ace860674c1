"""Reads takes of mocapd into NumPy arrays, and writes arrays as takes.

>>> import mocapd
>>> take = mocapd.open("jump.take")
>>> take.positions.shape            # frames, markers, axes; millimetres, NaN where a marker was not seen
(1200, 15, 3)
>>> take["LKNE"].read(start_s=2.0, stop_s=3.0)      # one second of one marker

Positions are float32 millimetres, right-handed, in the axes of the device or the imported file. Every sample is within
``take.header.tolerance_mm`` of the recorded one (Euclidean distance in 3D): the encoder verified each of them.

>>> with mocapd.open("walk.take") as take:          # imported from a C3D file
...     emg = take.analog["EMG1"].values            # in its unit, at its own rate
...     plate = take.force_plates[0]
...     plate.force_n, plate.cop_mm                 # in the laboratory's axes

>>> with mocapd.open("jump.take") as take:          # recorded from a device with force plates
...     for group in take.sampled:                  # of an import, its analog channels
...         group.time_s, group.values              # seconds from the first frame, each channel in its unit
...     take.force_plates[0].force_n                # as of an import
...     take.poses.names, take.poses.positions      # of its rigid bodies: frames, bodies, axes; millimetres
...     take.poses.quaternions                      # w, x, y, z
"""

from importlib.metadata import version

from ._analog import Analog, AnalogChannel
from ._arrays import compress, decompress, write_take
from ._force_plates import ForcePlate, PlateLoads
from ._marker import Marker, MarkerSummary
from ._native import TakeError
from ._poses import PoseArrays, Poses
from ._records import ClockLine, Device, Ending, Event, Header, Ledger, LostFrames, Source, Times
from ._sampled import SampledGroup
from ._subject import Subject
from ._take import Take, TakeWarning, open

__version__ = version("mocapd")

__all__ = [
    "Analog",
    "AnalogChannel",
    "ClockLine",
    "Device",
    "Ending",
    "Event",
    "ForcePlate",
    "Header",
    "Ledger",
    "LostFrames",
    "Marker",
    "MarkerSummary",
    "PlateLoads",
    "PoseArrays",
    "Poses",
    "SampledGroup",
    "Source",
    "Subject",
    "Take",
    "TakeError",
    "TakeWarning",
    "Times",
    "compress",
    "decompress",
    "open",
    "write_take",
]
