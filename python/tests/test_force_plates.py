"""Loads on force plates of imported C3D files: known loads, and those that ezc3d computes."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import mocapd
from c3d_files import FORCE_PLATFORM, Plate, c3d_file, channel_records, plate_records, walk, words

FRAMES, RATIO = 40, 10
SAMPLES = FRAMES * RATIO
TIME_S = np.arange(SAMPLES) / 1000


def step(kind, centre_mm=(300.0, 200.0, 0.0), turn_deg=0.0, sensor_mm=None):
    """A step on a plate: the force rises and falls, and the point of application moves from heel to toe."""
    load = np.sin(np.pi * TIME_S / TIME_S[-1])
    # Always loaded enough for a centre of pressure.
    force_n = np.stack([60 * np.cos(9 * TIME_S), 90 * np.sin(7 * TIME_S), 30 + 770 * load], axis=1)
    point_mm = np.array(centre_mm) + np.stack([-120 + 500 * TIME_S, 40 - 90 * TIME_S, 0 * TIME_S], axis=1)
    if sensor_mm is None:
        sensor_mm = (120.0, 200.0, -45.0) if kind == 3 else (1.5, -2.5, -41.0)
    return Plate(kind, centre_mm, turn_deg, force_n, point_mm, 8 * np.sin(5 * TIME_S), sensor_mm)


def file_of(plates):
    """A C3D file of plates."""
    channels = np.concatenate([plate.channels() for plate in plates], axis=1)
    units = [unit for plate in plates for unit in units_of(plate)]
    records = channel_records(channels.shape[1], units=units) + plate_records(plates)
    return c3d_file(walk(FRAMES), channels, RATIO, records)


def units_of(plate):
    if plate.kind == 1:
        return ["N"] * 3 + ["mm"] * 2 + ["Nmm"]
    return ["V"] * 6 if plate.kind == 4 else ["N"] * 8 if plate.kind == 3 else ["N"] * 3 + ["Nmm"] * 3


def assert_loads(found, plate):
    np.testing.assert_allclose(found.time_s, TIME_S)
    np.testing.assert_allclose(found.force_n, plate.force_n, atol=2e-2)
    np.testing.assert_allclose(found.moment_nm, plate.moment_nm, atol=2e-2)
    np.testing.assert_allclose(found.cop_mm, plate.point_mm, atol=0.2)
    np.testing.assert_allclose(found.free_moment_nm, plate.free_moment_nm, atol=2e-2)


@pytest.mark.parametrize("turn_deg", [0, 90, 37])
@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_a_known_load_is_found(imported, kind, turn_deg):
    known = step(kind, turn_deg=turn_deg)
    take = imported(file_of([known]))
    (plate,) = take.force_plates
    assert (plate.number, plate.type) == (1, kind)
    np.testing.assert_allclose(plate.corners_mm, known.corners_mm, atol=1e-3)
    np.testing.assert_allclose(plate.origin_mm, known.sensor_mm, atol=1e-4)
    assert [channel.index for channel in plate.channels] == list(range(8 if kind == 3 else 6))
    if kind == 4:
        # From newton millimetres to newton metres.
        expected = known.calibration * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])[:, None]
        np.testing.assert_allclose(plate.calibration, expected, rtol=1e-6)
    assert_loads(plate.loads, known)


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_ezc3d_finds_the_same_loads(imported, tmp_path, kind):
    ezc3d = pytest.importorskip("ezc3d")
    take = imported(file_of([step(kind), step(kind, (900.0, 150.0, 20.0), 180)]))
    theirs = ezc3d.c3d(str(tmp_path / "a.c3d"), extract_forceplat_data=True)["data"]["platform"]
    for plate, other in zip(take.force_plates, theirs, strict=True):
        np.testing.assert_allclose(plate.force_n, other["force"].T, atol=1e-3)
        np.testing.assert_allclose(plate.cop_mm, other["center_of_pressure"].T, atol=1e-2)
        np.testing.assert_allclose(plate.corners_mm, other["corners"].T, atol=1e-3)
        # ezc3d gives moments in newton millimetres; of type 1 with the opposite sign.
        sign = -1 if kind == 1 else 1
        np.testing.assert_allclose(sign * 1000 * plate.moment_nm, other["moment"].T, atol=1)


@pytest.mark.skipif(not os.environ.get("MOCAPD_TAKES"), reason="the environment variable MOCAPD_TAKES is not set")
def test_ezc3d_finds_the_same_loads_in_recorded_files(imported):
    ezc3d = pytest.importorskip("ezc3d")
    compared = 0
    for path in sorted(Path(os.environ["MOCAPD_TAKES"]).glob("*.c3d")):
        take = imported(path.read_bytes())
        with warnings.catch_warnings():
            # Several files have ORIGIN with the sign of early documentation.
            warnings.filterwarnings("ignore", "(?s).*ORIGIN of force plate", mocapd.TakeWarning)
            plates = take.force_plates
        if not plates:
            continue
        theirs = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]
        np.testing.assert_allclose(take.analog.values, theirs["analogs"][0].T, rtol=1e-6)
        factor = take.header.source.factor_to_mm
        for plate, other in zip(plates, theirs["platform"], strict=True):
            np.testing.assert_allclose(plate.force_n, other["force"].T, atol=1e-2)
            loaded = np.isfinite(plate.cop_mm[:, 0])
            cop_mm = factor * other["center_of_pressure"].T
            np.testing.assert_allclose(plate.cop_mm[loaded], cop_mm[loaded], atol=1e-1)
            compared += loaded.any()
    assert compared > 0


def test_plates_of_several_types_in_one_file(imported):
    known = [step(2), step(4, (900.0, 200.0, 0.0), 90), step(3, (300.0, 900.0, 0.0)), step(1, (900.0, 900.0, 5.0), 180)]
    take = imported(file_of(known))
    assert [plate.type for plate in take.force_plates] == [2, 4, 3, 1]
    for found, plate in zip(take.force_plates, known, strict=True):
        assert_loads(found.loads, plate)


def test_a_part_is_that_part_of_the_whole(imported):
    take = imported(file_of([step(2)]))
    (plate,) = take.force_plates
    part = plate.read(0.1, 0.25)
    for name in ("time_s", "force_n", "moment_nm", "cop_mm", "free_moment_nm"):
        np.testing.assert_array_equal(getattr(part, name), getattr(plate.loads, name)[100:250])
    assert plate.loads is plate.loads and plate.force_n is plate.loads.force_n
    with pytest.raises(ValueError, match="0.4.* 0.2"):
        plate.read(0.4, 0.2)


def test_an_unloaded_plate_has_no_centre_of_pressure(imported):
    known = step(2)
    known.force_n[100:200] = 0
    known.twist_nm[100:200] = 0
    (plate,) = imported(file_of([known])).force_plates
    assert np.isnan(plate.cop_mm[100:200]).all() and np.isfinite(plate.cop_mm[:100]).all()
    np.testing.assert_array_equal(plate.force_n[100:200], 0)


def test_a_plate_of_another_type_is_left_out_with_a_reason(imported):
    types = words(FORCE_PLATFORM, "TYPE", [2, 2]), words(FORCE_PLATFORM, "TYPE", [21, 2])
    known = [step(2), step(2, (900.0, 150.0, 20.0))]
    take = imported(file_of(known).replace(*types))
    with pytest.warns(mocapd.TakeWarning, match="force plate 1 .*21"):
        (plate,) = take.force_plates
    assert plate.number == 2 and any("21" in problem for problem in take.problems)
    assert_loads(plate.loads, known[1])


def test_a_take_with_z_down_is_turned_with_its_plates(imported):
    known = step(2)
    take = imported(file_of([known]), "--up", "-z")
    (plate,) = take.force_plates
    # Turned by 180 degrees, so that z points up.
    assert np.allclose(plate.force_n[:, 2], -known.force_n[:, 2], atol=1e-2)
    centre = plate.corners_mm.mean(axis=0)
    assert np.allclose(abs(centre), abs(known.centre_mm), atol=1e-3)
    assert take.header.up_axis == "z"
