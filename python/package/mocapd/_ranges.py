"""Times as indices of samples."""

from __future__ import annotations

import math

# Most samples to read at once: 12 GiB of positions. A few bytes of a damaged take can claim years of lost frames.
SAMPLES_MAX = 1 << 30


def index_at(time_s: float, rate_hz: float, n: int) -> int:
    """The first of ``n`` samples that is at or after a time; ``n`` if all are before it.

    A time that differs from a sample's only by rounding selects that sample.
    """
    if not time_s >= 0:
        raise ValueError(f"time {time_s} s: times are seconds from the first frame, 0 or more")
    at = min(time_s * rate_hz, float(n))
    nearest = round(at)
    found = nearest if abs(at - nearest) <= 1e-9 * max(at, 1.0) else math.ceil(at)
    return min(found, n)


def check_order(start: float | None, end: float | None) -> None:
    """Refuses a part that ends before it starts."""
    if start is not None and end is not None and end < start:
        raise ValueError(f"the part from {start} to {end} ends before it starts")


def index_range(start_s: float | None, stop_s: float | None, rate_hz: float, n: int) -> tuple[int, int]:
    """The range of the samples at or after ``start_s`` and before ``stop_s``: the first, and one past the last."""
    check_order(start_s, stop_s)
    first = 0 if start_s is None else index_at(start_s, rate_hz, n)
    stop = n if stop_s is None else index_at(stop_s, rate_hz, n)
    return first, stop


def check_size(n_samples: int, n_columns: int, what: str) -> None:
    """Refuses to read more at once than :data:`SAMPLES_MAX`."""
    if n_samples * max(n_columns, 1) > SAMPLES_MAX:
        raise ValueError(f"{n_samples} {what} are too many to read at once: give start_s and stop_s")


def unique_names(names: list[str] | tuple[str, ...]) -> list[str]:
    """The names, made unique: if several are the same, the later ones have their column appended, ``LKNE#7``."""
    found: dict[str, None] = {}
    for column, name in enumerate(names):
        while name in found:
            name = f"{name}#{column}"
        found[name] = None
    return list(found)
