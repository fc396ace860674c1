"""Bytes of every peer for every take and tolerance, as rows for JSON."""

from concurrent.futures import ProcessPoolExecutor

import takes
from cache import Cache
from families.registry import all_codecs
from mask import mask_bytes

TOLERANCES_MM = (0.1, 0.5, 1.0, 5.0, 10.0, 20.0)


def rows_of(path, cache_folder, codec_name, tolerances_mm, tuned=True):
    """The rows of one codec for one take; without `tuned` at the axis tolerances that are safe for any data only."""
    take = takes.load(path)
    cache = Cache(cache_folder, take.sha256, codec_name)
    codec = next(c for c in all_codecs() if c.name == codec_name)
    mask = 0 if codec.lossless else mask_bytes(take.present)
    rows = []
    for tolerance_mm in tolerances_mm:
        found = smallest(take, codec, cache, tolerance_mm, tuned=codec.tuned and tuned)
        if found:
            plain = smallest(take, codec, cache, tolerance_mm, tuned=False) if codec.tuned and tuned else found
            result, gaps = found
            more = {"gaps": gaps, "plain_bytes": plain[0].bytes + mask, "plain_layout": plain[0].layout}
            rows.append(row(take, codec, tolerance_mm, result, mask) | more)
    return rows


def smallest(take, codec, cache, tolerance_mm, tuned):
    """The smallest result over the methods of gap filling, and the method; None where the codec refuses the take."""
    found = []
    for filled in take.fills[:1] if codec.lossless else take.fills:
        # A lossless codec has one size for all tolerances.
        at = 0.0 if codec.lossless else tolerance_mm
        plain = codec.tuned and not tuned
        compute = lambda: codec.best(filled, tolerance_mm, tuned)  # noqa: E731
        result = cache.result(codec, filled.gaps, at, compute, plain)
        if result:
            found.append((result, filled.gaps))
    return min(found, key=lambda entry: entry[0].bytes, default=None)


def row(take, codec, tolerance_mm, result, mask):
    if not result.max_error_mm <= tolerance_mm:
        error_mm = result.max_error_mm
        raise AssertionError(f"{codec.name} on {take.name}: error {error_mm} mm exceeds {tolerance_mm} mm")
    return {
        "take": take.name,
        "samples": take.samples,
        "raw_bytes": take.raw_bytes,
        "filtered": take.filtered,
        "tolerance_mm": tolerance_mm,
        "codec": codec.name,
        "layout": result.layout,
        "bytes": result.bytes + mask,
        "mask_bytes": mask,
        "max_error_mm": result.max_error_mm,
        "axis_tolerance_mm": result.axis_tolerance,
    }


def all_rows(paths, cache_folder, processes=2, log=lambda text: None, found=lambda rows: None, names=None, tuned=True):
    """Rows of all codecs, or of those in `names`, for all takes.

    After each pair of codec and take, `log` is called with a line of progress and `found` with all rows so far.
    """
    jobs = [(path, codec.name) for codec in all_codecs() if not names or codec.name in names for path in paths]
    rows = []
    with ProcessPoolExecutor(processes) as pool:
        futures = [pool.submit(rows_of, path, cache_folder, name, TOLERANCES_MM, tuned) for path, name in jobs]
        for number, ((path, name), future) in enumerate(zip(jobs, futures), 1):
            rows += future.result()
            log(f"{number}/{len(jobs)} {name}: {path.stem}")
            found(rows)
    return rows
