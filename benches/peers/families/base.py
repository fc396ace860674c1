"""What a codec of the bench is: ways (layouts) to encode a take at a tolerance, and the way back.

A lossy codec here is one way = one name, an encoder `(take, tolerance) -> bytes-like payload` and a decoder back to
channels (markers * 3, frames). `best` runs the ways, decodes, measures, and keeps the smallest payload whose
MEASURED error (float64 distance between float32 positions) is within the tolerance; a way that breaks it is dropped.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from takes import max_error_mm

# Per-axis tolerance that keeps the 3-D error within 1.
AXIS = 1 / math.sqrt(3)

# Rounding to float32 adds some 0.2 % at 0.1 mm and 4 m; a way that is further off does not keep its own bound.
OVERSHOOT_MAX = 1.05

# Tuned codecs: how many layouts are tuned (the smallest untuned ones), and the scan of axis tolerances in steps of 1 %:
# sizes and errors jump about between neighbouring tolerances, so each step may win.
# Above sqrt3 a single axis at its tolerance already breaks the bound; ZFP stays far below its tolerance.
WAYS_TUNED = 3
STEP = 1.01
FACTOR_MAX = 3.5
HOPELESS = 1.3  # times the bound: the scan ends, larger tolerances only err more


@dataclass
class Way:
    """A layout of one codec: `encode(take, axis_tolerance)` gives the payload, `decode(take, payload)` channels."""

    name: str
    encode: Callable
    decode: Callable
    size: Callable = len


@dataclass
class Result:
    """A verified payload: bytes without the mask, and the largest 3-D error found after decoding."""

    layout: str
    bytes: int
    max_error_mm: float
    axis_tolerance: float


@dataclass
class Codec:
    """`tuned` codecs may raise the axis tolerance until the measured 3-D error reaches the bound."""

    name: str
    versions: str
    ways: Callable  # take -> list of Way
    tuned: bool = False
    timed: bool = False
    lossless: bool = False

    def way_named(self, take, layout):
        """The way a result came from, to time it."""
        return next(way for way in self.ways(take) if way.name == layout)

    def best(self, take, tolerance_mm, tuned=True):
        """The smallest verified result over all ways; None where every way refuses the take.

        Without `tuned`, at the plain axis tolerance that keeps the bound whatever the data.
        """
        found = []
        for way in self.ways(take):
            result = lowered(take, way, tolerance_mm)
            if result:
                found.append((result.bytes, len(found), way, result))
        found.sort(key=lambda entry: entry[:2])
        results = [result for *_, result in found]
        if self.tuned and tuned:
            results += [raised(take, way, tolerance_mm, result) for *_, way, result in found[:WAYS_TUNED]]
        return min(results, key=lambda r: r.bytes, default=None)


def attempt(take, way, axis_tolerance):
    """Encode, decode, measure. A codec that refuses a layout (too few dimensions, too wide numbers) says ValueError."""
    try:
        payload = way.encode(take, axis_tolerance)
    except (ValueError, OverflowError):
        return None
    error = max_error_mm(take, way.decode(take, payload))
    return Result(way.name, way.size(payload), error, axis_tolerance)


def lowered(take, way, tolerance_mm):
    """The plain per-axis tolerance, lowered a little where rounding to float32 breaks the bound."""
    axis = tolerance_mm * AXIS
    for _ in range(6):
        result = attempt(take, way, axis)
        if result is None or result.max_error_mm <= tolerance_mm:
            return result
        if result.max_error_mm > OVERSHOOT_MAX * tolerance_mm:
            return None
        # Two parts in 1e5 beyond the overshoot: float32 at 4 m is 0.24 um, a quarter of a percent of 0.1 mm.
        axis *= min(tolerance_mm / result.max_error_mm, 1.0) * (1 - 2e-5)
    return None


def raised(take, way, tolerance_mm, start):
    """Scans axis tolerances above the plain one; keeps the smallest payload whose measured error is within the bound.

    A scan and not a bisection: the measured error does not grow evenly with the tolerance.
    """
    best = start
    for factor in STEP ** np.arange(1, np.log(FACTOR_MAX) / np.log(STEP)):
        result = attempt(take, way, start.axis_tolerance * factor)
        if result is None or result.max_error_mm > HOPELESS * tolerance_mm:
            break
        if result.max_error_mm <= tolerance_mm and result.bytes < best.bytes:
            best = result
    return best
