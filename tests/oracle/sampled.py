"""Analog channels and loads of force plates of a C3D file by ezc3d, and as each format holds them, read without the
project's code. An export must have the values of ezc3d, and every format the same float32 bits.

ezc3d 1.7.2 reads 16-bit analog samples as signed, whatever ANALOG:FORMAT says, and takes offsets without their sign; it
states a centre of pressure for unloaded plates as well, and the moments of plates of type 1 with the opposite sign.
"""

import gzip
import json
from dataclasses import dataclass

import numpy as np

import compare
import readers

THRESHOLD_N = 20.0
KINDS = ["analog", "force_plates"]
# The quantities of a load, with their units and how far ezc3d may be away: it calculates in double, too, but from the
# corners and products in another order. A millionth of a larger value is allowed as well.
QUANTITIES = [("force", "N", 1e-3), ("moment", "N m", 1e-3), ("cop", "mm", 1e-2), ("free_moment", "N m", 1e-3)]


@dataclass
class Table:
    """What a reader found: a row for each sample."""

    names: list
    units: list
    rate_hz: float
    times_s: np.ndarray
    values: np.ndarray  # (samples, columns); NaN where a value is missing
    tolerance: np.ndarray | None = None  # of each value, in the expected table alone


def expected(path):
    """By ezc3d: a table for each kind that the file has."""
    import ezc3d

    file = ezc3d.c3d(str(path), extract_forceplat_data=True)
    values = file["data"]["analogs"][0].T
    if not values.size:
        return {}
    group, n = file["parameters"]["ANALOG"], values.shape[1]
    words, scales, offsets = stored(file)
    values = (words - offsets) * scales
    n_frames = file["data"]["points"].shape[2]
    rate_hz = len(values) / n_frames * file["parameters"]["POINT"]["RATE"]["value"][0]
    times_s = np.arange(len(values)) / rate_hz
    names = [label or f"A{number}" for number, label in enumerate(texts(group, "LABELS", n), 1)]
    # What is rounded: the sample, and the difference.
    tolerance = 2e-7 * (np.abs(values) + np.abs(offsets * scales)) + 1e-30
    tables = {"analog": Table(unique(names), texts(group, "UNITS", n), rate_hz, times_s, values, tolerance)}
    plates = [loads(plate) for plate in file["data"].get("platform", [])]
    if plates:
        kinds = listed(file["parameters"]["FORCE_PLATFORM"], "TYPE", len(plates), 0)
        for plate, kind in zip(plates, kinds):
            plate["moment"] *= -1 if kind == 1 else 1
        values = np.concatenate([plate[quantity] for plate in plates for quantity, *_ in QUANTITIES], axis=1)
        tolerance = np.repeat([tolerance for _ in plates for *_, tolerance in QUANTITIES], 3)
        tolerance = np.maximum(tolerance, 1e-6 * np.abs(values))
        columns = columns_of_plates(range(1, len(plates) + 1))
        tables["force_plates"] = Table(*columns, rate_hz, times_s, values, tolerance)
    return tables


def ending_of(unit):
    return unit.replace(" ", "").lower()


def columns_of_plates(numbers):
    """The names and the units of the columns of these force plates."""
    quantities = [(quantity, axis, unit) for quantity, unit, _ in QUANTITIES for axis in "xyz"]
    names = [f"force_plate_{n}.{quantity}_{axis}_{ending_of(unit)}" for n in numbers for quantity, axis, unit in quantities]
    return names, [unit for _ in numbers for *_, unit in quantities]


def loads(plate):
    """A plate's loads in N, N m and mm; no centre of pressure and no free moment below the threshold."""
    to_mm = {"mm": 1.0, "cm": 10.0, "m": 1000.0}[plate["unit_position"].strip("\0 ")]
    corners = plate["corners"].T
    normal = np.cross(corners[0] - corners[1], corners[0] - corners[3])
    force = plate["force"].T
    loaded = np.abs(force @ normal) / np.linalg.norm(normal) >= THRESHOLD_N
    only = lambda values: np.where(loaded[:, None], values, np.nan)
    return {
        "force": force,
        "moment": plate["moment"].T * to_mm / 1000,
        "cop": only(plate["center_of_pressure"].T * to_mm),
        "free_moment": only(plate["Tz"].T * to_mm / 1000),
    }


def stored(file):
    """The words of the analog samples as the file has them, and their scales and offsets."""
    group, values = file["parameters"]["ANALOG"], file["data"]["analogs"][0].T
    scales = listed(group, "SCALE", values.shape[1], 1.0) * group["GEN_SCALE"]["value"][0]
    offsets = listed(group, "OFFSET", values.shape[1], 0.0)
    words = values / scales + np.abs(offsets)
    says_so = "FORMAT" in group and readers.strings(group["FORMAT"]["value"])[:1] == ["UNSIGNED"]
    if file["parameters"]["POINT"]["SCALE"]["value"][0] > 0:
        words = np.round(words)
        if says_so:
            words, offsets = (np.where(signed < 0, signed + 65536, signed) for signed in (words, offsets))
    return words, scales, offsets


def same_words(before, after):
    """Whether a C3D export has the samples of its source, where it has floats for integers."""
    values = [file["data"]["analogs"] for file in (before, after)]
    if values[0].size == 0 or before["parameters"]["POINT"]["SCALE"]["value"][0] < 0:
        return np.array_equal(*values, equal_nan=True)
    words = [stored(file)[0] for file in (before, after)]
    # float32, scaled and back.
    return words[0].shape == words[1].shape and bool((np.abs(words[0] - words[1]) < 1e-2).all())


def listed(group, name, n, default):
    values = np.asarray(group[name]["value"]) if name in group else np.array([])
    return np.concatenate([values, np.full(n, default)])[:n] if len(values) < n else values[:n]


def texts(group, name, n):
    values = [text.strip() for text in readers.strings(group[name]["value"])] if name in group else []
    return (values + [""] * n)[:n]


def unique(names):
    used, found = set(), []
    for name in names:
        free, number = name, 2
        while free in used:
            free, number = f"{name}#{number}", number + 1
        used.add(free)
        found.append(free)
    return found


# Readers: of a path and a kind; None if the export has no such table.


def at_times(names, units, times_s, values):
    """A table whose format states no rate."""
    rate_hz = (len(times_s) - 1) / (times_s[-1] - times_s[0])
    return Table(list(names), list(units), rate_hz, times_s, np.asarray(values, dtype=np.float32))


def names_and_units(texts):
    """Of texts such as `Fz1 (N)`."""
    return zip(*(text.removesuffix(")").rsplit(" (", 1) if text.endswith(")") else [text, ""] for text in texts))


def read_csv(path, kind):
    import csv

    import pandas

    path = path.with_name(f"{path.stem}.{kind}.csv")
    if not path.exists():
        return None
    with open(path, newline="", encoding="utf-8") as file:
        names = next(csv.reader(file))
    data = pandas.read_csv(path, header=None, skiprows=1, float_precision="round_trip", dtype=np.float64).to_numpy()
    assert names[0] == "time_s", names[0]
    names, units = names_and_units(names[1:])
    if kind == "force_plates":
        # The names of loads end in their units.
        endings = {ending_of(unit): unit for _, unit, _ in QUANTITIES}
        units = [endings[name.rsplit("_", 1)[1]] for name in names]
    return at_times(names, units, data[:, 0], data[:, 1:])


def read_npz(path, kind):
    with np.load(path, allow_pickle=False) as found:
        if kind not in found:
            return None
        # The loads of an imported file are at the times of its analog samples.
        own = kind if f"{kind}_time_s" in found else "analog"
        values, times_s, rate_hz = found[kind], found[f"{own}_time_s"], float(found[f"{own}_rate_hz"])
        assert values.dtype == np.float32
        if kind != "force_plates":
            names, units = found[f"{kind}_labels"].tolist(), found[f"{kind}_units"].tolist()
        else:
            numbers = found["force_plate_numbers"]
            assert values.shape[1:] == (len(numbers), 4, 3)
            names, units = columns_of_plates(numbers)
            values = values.reshape(len(values), -1)
    return Table(names, units, rate_hz, times_s, values)


def read_xdf(path, kind):
    import pyxdf

    name = f"mocapd {kind.replace('_', ' ')}"
    streams = [stream for stream in pyxdf.load_xdf(str(path))[0] if stream["info"]["name"] == [name]]
    if not streams:
        return None
    (stream,) = streams
    assert stream["info"]["type"] == ["Force" if kind == "force_plates" else "Analog"]
    channels = stream["info"]["desc"][0]["channels"][0]["channel"]
    assert stream["time_series"].dtype == np.float32
    names, units = ([channel[field][0] or "" for channel in channels] for field in ("label", "unit"))
    rate_hz = float(stream["info"]["nominal_srate"][0])
    if rate_hz == 0:  # a recording, whose samples have times of their own
        return at_times(names, units, stream["time_stamps"], stream["time_series"])
    return Table(names, units, rate_hz, stream["time_stamps"], stream["time_series"])


def read_bids(folder, kind):
    import pandas

    name = kind.replace("_", "")
    files = list(folder.glob(f"sub-*/motion/*_recording-{name}_physio.tsv.gz"))
    if not files:
        return None
    (path,) = files
    about = json.loads(path.with_name(path.name.replace(".tsv.gz", ".json")).read_text(encoding="utf-8"))
    with gzip.open(path) as file:
        values = pandas.read_csv(file, sep="\t", header=None, na_values=["n/a"], float_precision="round_trip").to_numpy()
    names, rate_hz = about["Columns"], about["SamplingFrequency"]
    assert values.shape[1] == len(names)
    times_s = about["StartTime"] + np.arange(len(values)) / rate_hz
    if names[0] == "time_s":  # a recording states the time of each sample
        assert values[0, 0] == about["StartTime"]
        names, times_s, values = names[1:], values[:, 0], values[:, 1:]
    units = [about[name].get("Units", "") for name in names]
    return Table(names, units, rate_hz, times_s, values.astype(np.float32))


def read_parquet(path, kind):
    """By pyarrow, with the metadata; the values of the other readers must be the same."""
    import columns

    path = path.with_name(f"{path.stem}.{kind}.parquet")
    if not path.exists():
        return None
    about = columns.metadata(path)
    described = json.loads(about["mocapd.columns"])
    assert about["mocapd.layout"] == kind
    tables = []
    for reader in columns.READERS:
        table = reader(path)
        assert list(table) == ["time_s"] + [column["name"] for column in described], (reader, list(table))
        tables.append(np.stack([np.asarray(values, dtype=np.float64) for values in table.values()], axis=1))
        if not np.array_equal(tables[0], tables[-1], equal_nan=True):
            raise ValueError(f"{reader.__name__} reads other values")
    names, units = ([column[field] for column in described] for field in ("name", "unit"))
    rate_hz = float(about["mocapd.sampled_rate_hz"])
    return Table(names, units, rate_hz, tables[0][:, 0], tables[0][:, 1:].astype(np.float32))


def read_mcap(path, kind):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    times_ns, rows, fields, described = [], [], [], {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        about = {key: value for record in reader.iter_metadata() for key, value in record.metadata.items()}
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=[f"/{kind}"]):
            if not fields:
                fields = [field.name for field in decoded.DESCRIPTOR.fields if field.name != "timestamp"]
                described = channel.metadata
            assert message.log_time == decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
            times_ns.append(message.log_time)
            rows.append([getattr(decoded, field) for field in fields])
    if not rows:
        return None
    times_s = (np.array(times_ns) - int(about["mocapd.created_unix_ms"]) * 10**6) / 1e9
    return at_times(*names_and_units(described[field] for field in fields), times_s, rows)


def complaints(tables, path, read, first):
    """What differs from the tables of `expected`. `first` keeps the values of the first format of each kind, which the
    others must have to the bit."""
    wrong = []
    for kind in KINDS:
        found, wanted = read(path, kind), tables.get(kind)
        if found is None or wanted is None:
            if (found is None) != (wanted is None):
                wrong.append(f"{kind}: {'missing' if found is None else 'more than the file has'}")
            continue
        wrong += [f"{kind}: {words}" for words in differences(found, wanted)]
        values = first.setdefault(kind, np.ascontiguousarray(found.values))
        if not compare.same_bits(np.ascontiguousarray(found.values), values):
            wrong.append(f"{kind}: not the float32 bits of the first format")
    return wrong


def differences(found, wanted):
    wrong = []
    for what, a, b in [("names", found.names, wanted.names), ("units", found.units, wanted.units)]:
        if a != b:
            pairs = [pair for pair in zip(a, b) if pair[0] != pair[1]][:3]
            wrong.append(f"{what} differ: {len(a)} for {len(b)}, {pairs}")
    if found.values.shape != wanted.values.shape:
        return [*wrong, f"shape {found.values.shape}, expected {wanted.values.shape}"]
    if not np.isclose(found.rate_hz, wanted.rate_hz, rtol=1e-6):
        wrong.append(f"{found.rate_hz} Hz, expected {wanted.rate_hz}")
    if not np.allclose(found.times_s, wanted.times_s, rtol=1e-6, atol=2e-9):
        wrong.append("times do not follow the rate")
    apart = np.abs(found.values - wanted.values)
    n_other = int((np.isnan(found.values) != np.isnan(wanted.values)).sum())
    if n_other:
        wrong.append(f"{n_other} values are missing in one of both")
    far = apart > wanted.tolerance
    if far.any():
        row, column = np.argwhere(far)[0]
        example = f"{found.values[row, column]} for {wanted.values[row, column]}"
        wrong.append(f"{int(far.sum())} values differ, {found.names[column]} in row {row}: {example}")
    return wrong
