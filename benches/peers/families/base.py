"""The interface of a codec of the bench: a set of layouts (`Way`), each with an encoder and a decoder.

A layout has a name, an encoder `(take, tolerance) -> bytes-like payload` and a decoder to channels (markers * 3,
frames). `best` encodes with every layout, decodes, measures the error (float64 distance between float32 positions), and
returns the smallest payload whose measured error is within the tolerance; layouts that exceed it are dropped.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from takes import max_error_mm

# Tolerance per axis that keeps the 3-D error within 1.
AXIS = 1 / math.sqrt(3)

# Rounding to float32 adds about 0.2 % at 0.1 mm and 4 m; a layout with a larger excess violates its own bound.
OVERSHOOT_MAX = 1.05

# Tuned codecs: the number of layouts that are tuned (the smallest untuned ones), and a scan of axis tolerances in steps
# of 1 %. Sizes and errors do not vary smoothly between neighbouring tolerances, so every step is tried.
# Above sqrt3 a single axis at its tolerance already exceeds the bound, but ZFP stays far below its tolerance.
WAYS_TUNED = 3
STEP = 1.01
FACTOR_MAX = 3.5
HOPELESS = 1.3  # times the bound, where the scan ends: larger tolerances only increase the error


@dataclass
class Way:
    """A layout of one codec: `encode(take, axis_tolerance)` returns a payload, `decode(take, payload)` its channels."""

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
        """The layout of a result by its name, for timing."""
        return next(way for way in self.ways(take) if way.name == layout)

    def best(self, take, tolerance_mm, tuned=True):
        """The smallest verified result over all layouts; None where every layout refuses the take.

        Without `tuned`, at the axis tolerance that guarantees the bound for any data.
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
    """Encodes, decodes and measures. A codec raises ValueError for a layout that it refuses (too few dimensions, too
    wide numbers) or in which it hangs."""
    try:
        payload = way.encode(take, axis_tolerance)
        error = max_error_mm(take, way.decode(take, payload))
    except (ValueError, OverflowError):
        return None
    return Result(way.name, way.size(payload), error, axis_tolerance)


def lowered(take, way, tolerance_mm):
    """The result at the guaranteed axis tolerance, lowered slightly where rounding to float32 exceeds the bound."""
    axis = tolerance_mm * AXIS
    for _ in range(6):
        result = attempt(take, way, axis)
        if result is None or result.max_error_mm <= tolerance_mm:
            return result
        if result.max_error_mm > OVERSHOOT_MAX * tolerance_mm:
            return None
        # Lowered by the excess and 2e-5 more: the spacing of float32 at 4 m is 0.24 um, a quarter percent of 0.1 mm.
        axis *= min(tolerance_mm / result.max_error_mm, 1.0) * (1 - 2e-5)
    return None


def raised(take, way, tolerance_mm, start):
    """Scans larger axis tolerances for the smallest payload whose measured error is within the bound.

    Bisection would not work: the measured error does not grow monotonically with the tolerance.
    """
    best = start
    for factor in STEP ** np.arange(1, np.log(FACTOR_MAX) / np.log(STEP)):
        result = attempt(take, way, start.axis_tolerance * factor)
        if result is None or result.max_error_mm > HOPELESS * tolerance_mm:
            break
        if result.max_error_mm <= tolerance_mm and result.bytes < best.bytes:
            best = result
    return best
