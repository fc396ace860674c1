import importlib.metadata
import sys

import numpy as np
import pytest

import mocapd
from c3d_files import c3d_file, channel_records, event_records, walk
from test_subject import with_subject
from test_force_plates import SAMPLES, file_of, step


def test_xarray_has_names_and_units(path):
    pytest.importorskip("xarray")
    take = mocapd.open(path)
    array = take.to_xarray(1, 2, ["M01", "M65"])
    assert array.dims == ("time", "marker", "axis") and array.shape == (120, 2, 3)
    assert array.attrs["units"] == "mm" and array.attrs["tolerance_mm"] == 0.5
    np.testing.assert_array_equal(array.sel(marker="M65").values, take[120:240, "M65"])
    np.testing.assert_allclose(array.time, np.arange(120, 240) / 120)
    assert take.to_xarray().shape == take.shape


def test_pandas_has_one_column_for_each_axis(path):
    pytest.importorskip("pandas")
    take = mocapd.open(path)
    frame = take.to_pandas(1, 2, ["M01", "M65"])
    assert frame.shape == (120, 6) and frame.index.name == "time_s"
    np.testing.assert_array_equal(frame["M65"].to_numpy(), take[120:240, "M65"])
    assert list(frame.columns)[:3] == [("M01", "x"), ("M01", "y"), ("M01", "z")]


def test_pandas_states_units_and_axes(path):
    pytest.importorskip("pandas")
    attributes = mocapd.open(path).to_pandas(0, 1).attrs
    assert (attributes["units"], attributes["up_axis"], attributes["tolerance_mm"]) == ("mm", "z", 0.5)
    assert "right-handed" in attributes["axes"] and attributes["rate_hz"] == 120


def test_pandas_long_has_one_row_for_each_sample(path):
    pandas = pytest.importorskip("pandas")
    take = mocapd.open(path)
    wide = take.to_pandas("positions", 1, 20, ["M65", "M03"])
    long = take.to_pandas(1, 20, ["M65", "M03"], layout="long")
    assert list(long.columns) == ["frame", "marker", "x", "y", "z"] and long.index.name == "time_s"
    assert len(long) == np.isfinite(take.read(1, 20, ["M65", "M03"])[:, :, 0]).sum() < 2 * len(wide)
    np.testing.assert_allclose(long.index, long["frame"] / 120)
    for label in ("M65", "M03"):
        one = long[long["marker"] == label].set_index("frame")[["x", "y", "z"]]
        frames = np.arange(120, 2400)
        expected = pandas.DataFrame(wide[label].to_numpy(), index=frames, columns=list("xyz")).dropna()
        np.testing.assert_array_equal(one.to_numpy(), expected.to_numpy())
        np.testing.assert_array_equal(one.index, expected.index)
    assert len(take.to_pandas(3, 3, layout="long")) == 0
    assert len(take.to_pandas(markers="M69", layout="long")) == 0


def test_pandas_long_distinguishes_markers_with_the_same_label(tmp_path, motion):
    pytest.importorskip("pandas")
    mocapd.write_take(tmp_path / "t.take", motion[:9, [1, 2, 4]], ["A", "A", "B"], 100)
    long = mocapd.open(tmp_path / "t.take").to_pandas(layout="long")
    assert list(long["marker"].unique()) == ["A", "A#1", "B"]


def test_pandas_has_the_analog_channels(imported):
    pytest.importorskip("pandas")
    samples = np.arange(600.0).reshape(300, 2)
    data = channel_records(2, labels=["Fz", "EMG"], units=["N", "mV"])
    take = imported(c3d_file(walk(30), samples, 10, data))
    frame = take.to_pandas("analog")
    assert list(frame.columns) == ["Fz", "EMG"] and frame.index.name == "time_s"
    assert frame.attrs == {"units": {"Fz": "N", "EMG": "mV"}, "rate_hz": 1000.0}
    np.testing.assert_array_equal(frame.to_numpy(), samples)
    np.testing.assert_allclose(frame.index, np.arange(300) / 1000)
    part = take.to_pandas("analog", 0.1, 0.2, "EMG")
    np.testing.assert_array_equal(part["EMG"], samples[100:200, 1])
    assert part.index[0] == 0.1


def test_pandas_has_the_force_plates(imported):
    pytest.importorskip("pandas")
    known = [step(2), step(4, (900.0, 150.0, 20.0), 90)]
    take = imported(file_of(known))
    frame = take.to_pandas("force_plates")
    assert frame.shape == (SAMPLES, 24) and frame.columns.names == ["plate", "quantity", "axis"]
    for number, plate in enumerate(known, 1):
        np.testing.assert_allclose(frame[number]["force_n"], plate.force_n, atol=2e-2)
        np.testing.assert_allclose(frame[number]["cop_mm"], plate.point_mm, atol=0.2)
        np.testing.assert_allclose(frame[number, "free_moment_nm", "z"], plate.free_moment_nm[:, 2], atol=2e-2)
    assert frame.attrs["units"]["moment_nm"] == "N m" and "right-handed" in frame.attrs["axes"]
    assert len(take.to_pandas("force_plates", 0.1, 0.2)) == 100


def test_pandas_has_the_events(imported):
    pandas = pytest.importorskip("pandas")
    events = event_records([0.1, 0.25], ["Left", "General"], ["Foot Strike", "Clap"])
    take = imported(c3d_file(walk(40), np.zeros((40, 0)), 1, events))
    frame = take.to_pandas("events")
    expected = pandas.DataFrame(
        {
            "time_s": [0.1, 0.25],
            "frame": [10, 25],
            "kind": ["mark", "mark"],
            "text": ["Left Foot Strike", "Clap"],
            "input": [0, 0],
            "device_ticks": [0, 0],
            "host_ns": [0, 0],
        }
    )
    pandas.testing.assert_frame_equal(frame, expected, check_dtype=False)
    none = imported(c3d_file(walk(40), np.zeros((40, 0)), 1, b"")).to_pandas("events")
    assert list(none.dtypes) == list(frame.dtypes) and frame.attrs["rate_hz"] == 100


def test_pandas_has_the_subject(program, tmp_path):
    pytest.importorskip("pandas")
    take = with_subject(program, tmp_path)
    frame = take.to_pandas("subject")
    assert list(frame.index) == ["l_thigh", "l_shank"] and frame.index.name == "bone"
    assert frame.loc["l_thigh", "length_mm"] == 412 and frame.loc["l_shank", "child"] == "l_ankle"
    assert np.isnan(frame.loc["l_thigh", "uncertainty_mm"]) and frame["scans"].isna().all()
    assert frame.attrs["name"] == "Anna" and frame.attrs["units"] == "mm"


def test_what_a_take_does_not_have_is_an_empty_frame(path):
    pytest.importorskip("pandas")
    take = mocapd.open(path)
    for content, columns in [
        ("analog", []),
        ("force_plates", []),
        ("events", ["time_s", "frame", "kind", "text", "input", "device_ticks", "host_ns"]),
        ("subject", ["parent", "child", "length_mm", "uncertainty_mm", "spread_mm", "scans"]),
    ]:
        frame = take.to_pandas(content)
        assert len(frame) == 0 and list(frame.columns) == columns, content
    assert len(take.to_pandas("analog", 1, 2)) == 0


def test_unknown_contents_and_layouts_are_refused(path):
    pytest.importorskip("pandas")
    take = mocapd.open(path)
    with pytest.raises(ValueError, match="'forces'.*'force_plates'"):
        take.to_pandas("forces")
    with pytest.raises(ValueError, match="'tidy'.*'long'"):
        take.to_pandas(layout="tidy")
    with pytest.raises(TypeError, match="markers"):
        take.to_pandas("events", markers="M01")


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_without_the_library_the_error_names_what_to_install(path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    assert name in importlib.metadata.metadata("mocapd").get_all("Provides-Extra")
    with pytest.raises(ImportError, match=rf"pip install '\./python\[{name}\]'"):
        getattr(mocapd.open(path), f"to_{name}")()
