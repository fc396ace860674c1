import importlib.metadata
import sys

import numpy as np
import pytest

import mocapd


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


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_without_the_library_the_error_names_what_to_install(path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    assert name in importlib.metadata.metadata("mocapd").get_all("Provides-Extra")
    with pytest.raises(ImportError, match=rf"pip install '\./python\[{name}\]'"):
        getattr(mocapd.open(path), f"to_{name}")()
