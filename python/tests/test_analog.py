"""Analog channels and parameters of imported C3D files, compared with what was written and with ezc3d."""

import re
import struct
import subprocess
import sys
import warnings
import zlib

import numpy as np
import pytest

import mocapd
from c3d_files import ANALOG, array, c3d_file, channel_records, floats, plate_records, texts, walk
from test_force_plates import step
from test_limits import chunk, varint

FRAMES, RATIO, CHANNELS = 60, 10, 3
SCALES, OFFSETS, GEN_SCALE = [0.5, 0.25, -2.0], [100, 0, -7], 0.01


def stored(channels=CHANNELS, frames=FRAMES):
    """Whole numbers within 12 bits, different in every sample."""
    sample = np.arange(frames * RATIO)[:, None]
    return np.round(1500 * np.sin(sample / 9 + np.arange(channels)) + sample / 10)


def records(offsets=OFFSETS, **changed):
    return channel_records(CHANNELS, scales=SCALES, offsets=offsets, gen_scale=GEN_SCALE, **changed)


def physical(samples):
    return (samples - OFFSETS) * np.float32(SCALES).astype(float) * float(np.float32(GEN_SCALE))


def test_channels_are_in_physical_units(imported):
    samples = stored()
    take = imported(c3d_file(walk(FRAMES), samples, RATIO, records(units=["N", "mV", ""])))
    analog = take.analog
    assert (len(analog), analog.n_samples, analog.samples_per_frame) == (CHANNELS, FRAMES * RATIO, RATIO)
    assert (analog.rate_hz, analog.duration_s) == (1000.0, 0.6)
    assert analog.names == ("C0", "C1", "C2") and "C1" in analog and "C9" not in analog
    assert [channel.unit for channel in analog] == ["N", "mV", ""]
    assert analog["C1"].description == "channel 2" and analog["C2"].offset == -7
    np.testing.assert_allclose(analog["C2"].scale, -0.02, rtol=1e-6)
    assert analog.values.dtype == np.float64 and analog.values is analog.values
    np.testing.assert_allclose(analog.values, physical(samples), rtol=1e-12)
    np.testing.assert_allclose(analog["C1"].values, physical(samples)[:, 1], rtol=1e-12)
    np.testing.assert_allclose(analog.time_s, np.arange(600) / 1000)
    # The samples of a frame begin at the frame's time.
    np.testing.assert_array_equal(analog.time_s[::RATIO], take.times().nominal_s)


def test_ezc3d_reads_the_same_values(imported, tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    # ezc3d 1.7.2 subtracts the magnitude of an offset.
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, records(offsets=[100, 0, 7])))
    theirs = ezc3d.c3d(str(tmp_path / "a.c3d"))
    np.testing.assert_allclose(take.analog.values, theirs["data"]["analogs"][0].T, rtol=1e-6)
    for group, parameters in theirs["parameters"].items():
        for name, parameter in parameters.items():
            ours = take.metadata.get(group, {}).get(name)
            # ezc3d adds parameters that the file does not have.
            if name.startswith("__") or ours is None:
                continue
            value = np.ravel(parameter["value"], order="F")
            found = np.ravel([ours] if isinstance(ours, (str, int, float)) else ours, order="F")
            assert list(value) == pytest.approx(list(found)) if value.dtype.kind in "fi" else list(value) == list(found)


@pytest.mark.parametrize("format", ["SIGNED", "UNSIGNED"])
def test_integers_are_signed_or_unsigned(imported, format):
    samples = stored()
    offsets = [-1000, 0, 30_000] if format == "SIGNED" else [2048, 0, 40_000]
    if format == "UNSIGNED":
        samples = np.clip(samples + 32_768, 0, 65_535)
    more = texts(ANALOG, "FORMAT", [format])
    data = channel_records(CHANNELS, scales=SCALES, offsets=offsets, more=more)
    take = imported(c3d_file(walk(FRAMES), samples, RATIO, data, scale=0.1))
    np.testing.assert_allclose(take.analog.values, (samples - offsets) * SCALES, rtol=1e-12)


def test_a_part_is_that_part_of_the_whole(imported):
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, records()))
    whole = take.analog.values
    for start_s, stop_s, part in [
        (0.1, 0.2, slice(100, 200)),
        (0.1001, 0.2001, slice(101, 201)),
        (None, 0.05, slice(0, 50)),
        (0.55, None, slice(550, 600)),
        (0.3, 0.3, slice(0, 0)),
        (5, 7, slice(0, 0)),
    ]:
        # Decoded anew, not from the whole.
        analog = mocapd.open(take.path).analog
        np.testing.assert_array_equal(analog.read(start_s, stop_s), whole[part])
        np.testing.assert_array_equal(analog.read(start_s, stop_s, ["C2", 0]), whole[part][:, [2, 0]])
        np.testing.assert_array_equal(analog["C1"].read(start_s, stop_s), whole[part][:, 1])
        np.testing.assert_array_equal(analog.times(start_s, stop_s), take.analog.time_s[part])
    with pytest.raises(ValueError, match="0.4.* 0.2"):
        analog.read(0.4, 0.2)
    with pytest.raises(ValueError, match="-1"):
        analog.read(-1)
    for wrong in ("nothing", 3, -1):
        with pytest.raises(KeyError, match=str(wrong)):
            analog.read(channels=wrong)


def test_a_long_file_is_read_in_parts(imported):
    """More samples than the native part decodes at once."""
    samples = stored(channels=7, frames=30_000)
    take = imported(c3d_file(walk(30_000), samples, RATIO, channel_records(7)))
    np.testing.assert_array_equal(take.analog.read(channels=[6, 0]), samples[:, [6, 0]])
    np.testing.assert_array_equal(take.analog.read(299.0), samples[299_000:])
    np.testing.assert_array_equal(take.analog.values, samples)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is measured in KiB on Linux")
def test_a_part_needs_little_memory(imported):
    """The samples, 20 MB, are never in memory as a whole."""
    samples = np.cumsum(np.random.default_rng(3).normal(0, 3, (80_000, 64)), axis=0).astype(np.float32)
    take = imported(c3d_file(walk(8000), samples, RATIO, channel_records(64)))
    code = (
        "import mocapd, resource, sys\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024\n"
        "mocapd.open(sys.argv[1]).read(1, 2)\n"
        "before = peak()\n"
        "part = mocapd.open(sys.argv[1]).analog.read(70, 71, ['C63'])\n"
        "print(part.sum(), peak() - before)"
    )
    ran = subprocess.run([sys.executable, "-c", code, take.path], capture_output=True, text=True, check=True)
    total, grown_mib = map(float, ran.stdout.split())
    assert total == pytest.approx(float(samples[70_000:71_000, 63].sum(dtype=np.float64)))
    assert grown_mib < 12


def test_channels_with_one_name_are_distinguished_by_index(imported):
    more = channel_records(CHANNELS, labels=["EMG", "EMG", "Fz"])
    analog = imported(c3d_file(walk(FRAMES), stored(), RATIO, more)).analog
    with pytest.raises(KeyError, match=r"'EMG'.*\[0, 1\]"):
        analog["EMG"]
    np.testing.assert_array_equal(analog[1].values, stored()[:, 1])


def test_a_group_that_states_little_is_completed_with_a_warning(imported):
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, b""))
    with pytest.warns(mocapd.TakeWarning, match="ANALOG:SCALE|ANALOG:OFFSET"):
        assert take.analog.names == ("A1", "A2", "A3")
    assert {channel.unit for channel in take.analog} == {""} and len(take.problems) == 2
    np.testing.assert_array_equal(take.analog.values, stored())
    short = floats(ANALOG, "SCALE", [0.5]) + texts(ANALOG, "LABELS", ["Fz"])
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, short))
    with pytest.warns(mocapd.TakeWarning, match="[23] channels of 3"):
        assert take.analog.names == ("Fz", "A2", "A3")
    np.testing.assert_array_equal(take.analog.values, stored() * [0.5, 1, 1])


def test_metadata_has_the_values_of_the_file(imported):
    more = array(ANALOG, "MATRIX", np.arange(24).reshape(2, 3, 4)) + texts(ANALOG, "NOTE", ["first", "second"])
    metadata = imported(c3d_file(walk(FRAMES) / 1000, stored(), RATIO, records(more=more), unit="m")).metadata
    assert list(metadata) == ["POINT", "ANALOG"]
    point, analog = metadata["POINT"], metadata["ANALOG"]
    assert (point["USED"], point["RATE"], point["UNITS"]) == (3, 100.0, ["m"])
    assert point["LABELS"] == ["M0", "M1", "M2"] and analog["NOTE"] == ["first", "second"]
    assert isinstance(point["USED"], int) and isinstance(point["RATE"], float)
    np.testing.assert_array_equal(analog["OFFSET"], OFFSETS)
    np.testing.assert_array_equal(analog["MATRIX"], np.arange(24).reshape(2, 3, 4))


def test_takes_without_a_c3d_file_have_none(path):
    take = mocapd.open(path)
    assert len(take.analog) == 0 and list(take.analog) == [] and "C0" not in take.analog
    assert take.analog.values.shape == (0, 0) and take.analog.time_s.shape == (0,)
    assert (take.analog.rate_hz, take.analog.n_samples, take.analog.read(1, 2).shape) == (0.0, 0, (0, 0))
    assert take.metadata == {} and take.force_plates == () and take.subject is None
    with pytest.raises(KeyError, match="C0"):
        take.analog["C0"]


def test_a_c3d_file_without_analog_channels_has_none(imported):
    take = imported(c3d_file(walk(FRAMES), np.zeros((FRAMES, 0)), 1, b""))
    assert len(take.analog) == 0 and take.force_plates == () and take.metadata["ANALOG"]["USED"] == 0


def test_an_import_that_drops_them_has_none(imported):
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, records()), "--drop-foreign")
    assert len(take.analog) == 0 and take.metadata == {}


def test_damage_is_an_error_or_a_warning(imported, tmp_path):
    """Reading what a damaged chunk had is an error, or a warning and NaN, not an empty result."""
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, records()))
    expected = take.analog.values
    with open(take.path, "rb") as file:
        data = file.read()

    def damaged(at):
        changed = bytearray(data)
        changed[at] ^= 1
        (tmp_path / "damaged.take").write_bytes(changed)
        with pytest.warns(mocapd.TakeWarning):
            take = mocapd.open(tmp_path / "damaged.take")
        assert any("checksum" in problem for problem in take.problems)
        return take

    group_at = next(at for kind, at, _ in places_of(data) if kind == SAMPLED_GROUP)
    for at, part in ((group_at + 5, "analog"), (data.index(b"c3d/parameters") + 100, "parameters")):
        take = damaged(at)
        with pytest.raises(mocapd.TakeError, match=rf"damaged.take.*{part}"):
            take.analog
        assert take.read().shape == take.shape
        if part == "analog":
            assert take.metadata["ANALOG"]["USED"] == CHANNELS
        else:
            with pytest.raises(mocapd.TakeError, match="damaged.take.*parameters"):
                take.metadata
    samples_at = next(at for kind, at, _ in places_of(data) if kind == SAMPLES)
    take = damaged(samples_at + 40)
    assert any(re.search("samples 0 to 599 of c3d/analog.*are lost", problem) for problem in take.problems)
    assert take.analog.values.shape == expected.shape and np.isnan(take.analog.values).all()
    # A take that was cut off has them: they precede the frames.
    (tmp_path / "cut.take").write_bytes(data[: len(data) - 40])
    with pytest.warns(mocapd.TakeWarning):
        take = mocapd.open(tmp_path / "cut.take")
    np.testing.assert_array_equal(take.analog.values, expected)


def test_samples_that_a_recovery_lost_are_a_warning(imported, program, tmp_path):
    take = imported(c3d_file(walk(FRAMES), stored(), RATIO, records()))
    with open(take.path, "rb") as file:
        data = bytearray(file.read())
    data[next(at for kind, at, _ in places_of(data) if kind == SAMPLES) + 40] ^= 1
    (tmp_path / "damaged.take").write_bytes(data)
    recover = [program, "recover", tmp_path / "damaged.take", "-o", tmp_path / "recovered.take"]
    assert subprocess.run(recover, capture_output=True).returncode == 3
    take = mocapd.open(tmp_path / "recovered.take")
    with pytest.warns(mocapd.TakeWarning, match="samples 0 to 599 of c3d/analog.*are lost"):
        analog = take.analog
    assert np.isnan(analog.values).all()


def places_of(data):
    """The chunks of a take: type, and where the payload begins and ends."""
    at, found = 8, []
    while at < len(data):
        kind, length, shift = data[at], 0, 0
        at += 1
        while True:
            length |= (data[at] & 0x7F) << shift
            shift += 7
            at += 1
            if data[at - 1] < 0x80:
                break
        found.append((kind, at, at + length))
        at += length + 4
    return found


def chunks_of(data):
    """The chunks of a take: type and payload."""
    return [(kind, data[start:end]) for kind, start, end in places_of(data)]


FOREIGN, INDEX, SAMPLED_GROUP, SAMPLES = 0x89, 0x8A, 0x8E, 0x8F


def deflated(content):
    deflate = zlib.compressobj(wbits=-15)
    return deflate.compress(bytes(content)) + deflate.flush()


def foreign_analog(samples, ratio):
    """FOREIGN as earlier versions wrote it for float32, after docs/foreign.md."""
    bits = samples.astype("<f4").view(np.uint32)
    ordered = np.where(bits >> 31, ~bits, bits | np.uint32(1 << 31))
    difference = np.diff(ordered, axis=0, prepend=np.uint32(0)).view(np.int32)
    zigzag = (difference << 1 ^ difference >> 31).view(np.uint32).T
    header = struct.pack("<BBIIQQ", 1, 4, samples.shape[1], ratio, 1, len(samples) // ratio)
    planes = (row >> shift & 0xFF for row in zigzag for shift in (24, 16, 8, 0))
    content = header + b"".join(plane.astype(np.uint8).tobytes() for plane in planes)
    kind = b"c3d/analog"
    return bytes([len(kind)]) + kind + varint(len(content)) + deflated(content)


@pytest.mark.parametrize("part", [b"c3d/analog", b"c3d/parameters", SAMPLED_GROUP])
def test_any_content_of_a_part_is_read_or_a_take_error(imported, tmp_path, part):
    """Content that no importer writes, in chunks that are intact."""
    plate = step(2)
    group = channel_records(6, units=["N"] * 3 + ["Nmm"] * 3) + plate_records([plate])
    take = imported(c3d_file(walk(40), plate.channels(), 10, group))
    expected = take.force_plates[0].force_n
    with open(take.path, "rb") as file:
        data = file.read()
    chunks = chunks_of(data)
    if part == b"c3d/analog":
        group_at = next(at for at, (kind, _) in enumerate(chunks) if kind == SAMPLED_GROUP)
        chunks[group_at] = (FOREIGN, foreign_analog(plate.channels(), 10))
        chunks = [(kind, payload) for kind, payload in chunks if kind != SAMPLES]
    if part == SAMPLED_GROUP:
        # The version precedes the deflated content.
        (original,) = (payload for kind, payload in chunks if kind == SAMPLED_GROUP)
        start = deflated_at = 2
    else:
        # Kind and length precede the deflated content.
        (original,) = (payload for kind, payload in chunks if kind == FOREIGN and payload[1:].startswith(part))
        start = 1 + len(part)
        deflated_at = next(at for at in range(start, start + 9) if original[at] < 0x80) + 1
    content = zlib.decompress(original[deflated_at:], wbits=-15)
    random = np.random.default_rng(17)
    read = refused = 0
    for number in range(150):
        changed = bytearray(content)
        for _ in range(int(random.integers(1, 4)) if number else 0):
            changed[int(random.integers(0, min(len(changed), 700)))] = int(random.choice([0, 1, 6, 127, 128, 255]))
        changed = changed[: int(random.integers(0, len(changed)))] if number % 10 == 9 else changed
        length = b"" if part == SAMPLED_GROUP else varint(len(changed))
        payload = original[:start] + length + deflated(changed)
        parts = [(kind, payload if body == original else body) for kind, body in chunks]
        # Without its index, whose offsets are others now, the take is one that was cut off.
        parts = parts[: next(at for at, (kind, _) in enumerate(parts) if kind == INDEX)]
        (tmp_path / "changed.take").write_bytes(data[:8] + b"".join(chunk(*one) for one in parts))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                other = mocapd.open(tmp_path / "changed.take")
                found = [plate.force_n for plate in other.force_plates]
                assert other.analog.values.shape == (other.analog.n_samples, len(other.analog))
                assert isinstance(other.metadata, dict)
                read += 1
            except mocapd.TakeError as error:
                assert "changed.take" in str(error)
                refused += 1
        if number == 0:
            np.testing.assert_array_equal(found[0], expected)
    # Parameters are read up to the first invalid one.
    assert read > 10 and refused > 0
