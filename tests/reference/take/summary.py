"""SUMMARY: docs/take-format.md."""

import zlib
from dataclasses import dataclass

from .container import Record, read_header, read_order
from .cursor import Cursor
from .errors import Corrupt
from .range_coder import RangeDecoder
from .timeline import Number

ENDING, HEADER, STATISTICS, ORDER = 1, 2, 3, 5
ENDINGS = ["stopped", "length", "device ended", "device gone", "disk full", "service stopped", "saved", "cut off",
           "truncated", "unmounted"]  # fmt: skip


@dataclass
class Statistics:
    channels: list  # (samples, gaps, kept samples, largest stated error in mm)
    rows_with_samples: int
    key_rows: int
    samples_in_key_rows: int


@dataclass
class Summary:
    ending: tuple | None = None  # (name, detail)
    header: object = None
    statistics: Statistics | None = None
    order: list | None = None


def read_summary(payload, tolerance_mm):
    """The sections that this decoder knows."""
    cursor, summary = Cursor(payload), Summary()
    if int.from_bytes(cursor.take(2), "little") != 1:
        return summary
    while cursor.left():
        tag, content = cursor.varint(), cursor.take(cursor.varint())
        if content[:2] != b"\x01\x00":
            continue
        if tag == ENDING:
            summary.ending = read_ending(content)
        elif tag == HEADER:
            summary.header = read_header(zlib.decompress(content[2:], wbits=-15))
        elif tag == STATISTICS:
            summary.statistics = read_statistics(content[2:], tolerance_mm)
        elif tag == ORDER:
            summary.order = read_order(content)
    return summary


def read_ending(content):
    record = Record(content, 1)
    kind, detail = record.unsigned(), record.string()
    record.finish()
    return (ENDINGS[kind - 1] if 1 <= kind <= len(ENDINGS) else f"kind {kind}", detail)


def read_statistics(content, tolerance_mm):
    cursor = Cursor(content)
    n_channels, rows = cursor.varint(), cursor.varint()
    coder = RangeDecoder(cursor.rest())
    models, figures, channels = [Number(32) for _ in range(4)], [rows, 0, 0, 63], []
    for _ in range(n_channels):
        figures = [figure + model.read(coder) for figure, model in zip(figures, models)]
        samples, gaps, kept, step = figures
        channels.append((samples, gaps, kept, tolerance_mm if step == 63 else tolerance_mm * step / 63))
    last = Number(32)
    key_rows = rows + last.read(coder)
    in_key_rows = sum(channel[0] for channel in channels) + last.read(coder)
    coder.finish()
    return Statistics(channels, rows, key_rows, in_key_rows)


def counted(take):
    """The statistics of a decoded take, as their definitions read."""
    channels, in_rows, key_rows = [], {}, set()
    for i in range(len(take.channels)):
        track = take.tracks.get(i, {})
        starts = (row not in track and (row == 0 or row - 1 in track) for row in range(take.n_rows))
        kept = [row for row, (_, is_kept) in track.items() if is_kept]
        channels.append((len(track), sum(starts), len(kept), take.stated_by_channel.get(i, 0.0)))
        key_rows.update(kept)
        for row in track:
            in_rows[row] = in_rows.get(row, 0) + 1
    return Statistics(channels, len(in_rows), len(key_rows), sum(in_rows[row] for row in key_rows))


def check(summary, take):
    """Compares the summary of a whole take with its content."""
    if summary.header and (summary.header.channels != take.channels or summary.header.take_id != take.header.take_id):
        raise Corrupt("the summary has another header")
    if summary.statistics and summary.statistics != counted(take):
        raise Corrupt(f"the summary states {summary.statistics}, counted are {counted(take)}")
    if summary.order and summary.order != take.order:
        raise Corrupt("the summary has another order of the markers")
