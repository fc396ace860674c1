"""Takes as tables of pandas, and as arrays of xarray."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ._force_plates import ForcePlate, read_loads
from ._native import TakeError
from ._ranges import unique_names

if TYPE_CHECKING:
    import pandas
    import xarray

    from ._analog import Analog, Channels
    from ._marker import Markers
    from ._poses import Bodies
    from ._take import Take

# The package is installed from its folder: no registry has it.
_NEEDS = "{0} needs {1}: pip install {1}, or pip install './python[{1}]' in mocapd's folder"


def to_xarray(take: Take, start_s: float | None, stop_s: float | None, markers: Markers) -> xarray.DataArray:
    """See :meth:`Take.to_xarray`."""
    try:
        import xarray
    except ImportError as error:
        raise ImportError(_NEEDS.format("to_xarray()", "xarray")) from error
    values, columns, time_s = take._part(start_s, stop_s, markers)
    return xarray.DataArray(
        values,
        dims=("time", "marker", "axis"),
        coords={
            "time": ("time", time_s, {"units": "s"}),
            "marker": [take.labels[column] for column in columns],
            "axis": list("xyz"),
        },
        name="position",
        attrs={"units": "mm", "rate_hz": take.rate_hz, "tolerance_mm": take.header.tolerance_mm},
    )


def to_pandas(take: Take, content: str, *part: Any, **options: Any) -> pandas.DataFrame:
    """See :meth:`Take.to_pandas`."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(_NEEDS.format("to_pandas()", "pandas")) from error
    if content not in _TABLES:
        names = ", ".join(map(repr, _TABLES))
        raise ValueError(f"to_pandas({content!r}): use one of {names}")
    frame: pandas.DataFrame = _TABLES[content](pandas, take, *part, **options)
    return frame


def _axes(take: Take) -> dict[str, object]:
    """The attributes that state the axes of positions and forces."""
    whose = "device" if take.header.source is None else "imported file"
    return {"axes": f"those of the {whose}, right-handed", "up_axis": take.header.up_axis}


def _positions(
    pandas: ModuleType,
    take: Take,
    start_s: float | None = None,
    stop_s: float | None = None,
    markers: Markers = None,
    *,
    layout: Literal["wide", "long"] = "wide",
) -> pandas.DataFrame:
    if layout not in ("wide", "long"):
        raise ValueError(f"layout={layout!r}: use 'wide' or 'long'")
    values, columns, time_s = take._part(start_s, stop_s, markers)
    index = pandas.Index(time_s, name="time_s")
    if layout == "wide":
        names = [(take.labels[column], axis) for column in columns for axis in "xyz"]
        frame = pandas.DataFrame(
            values.reshape(len(values), -1),
            index=index,
            columns=pandas.MultiIndex.from_tuples(names, names=["marker", "axis"]),
        )
    else:
        names = unique_names([take.labels[column] for column in columns])
        rows, places = np.nonzero(~np.isnan(values[:, :, 0]))
        first = round(time_s[0] * take.rate_hz) if len(time_s) else 0
        positions = values[rows, places]
        frame = pandas.DataFrame(
            {"frame": first + rows, "marker": pandas.Categorical.from_codes(places, names)}
            | {axis: positions[:, number] for number, axis in enumerate("xyz")},
            index=index[rows],
        )
    tolerance = {"rate_hz": take.rate_hz, "tolerance_mm": take.header.tolerance_mm}
    frame.attrs = {"units": "mm", **_axes(take), **tolerance}
    return frame


def _analog(
    pandas: ModuleType,
    take: Take,
    start_s: float | None = None,
    stop_s: float | None = None,
    channels: Channels = None,
) -> pandas.DataFrame:
    return _channels(pandas, take.analog, start_s, stop_s, channels)


def _sampled(
    pandas: ModuleType,
    take: Take,
    group: int | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    channels: Channels = None,
) -> pandas.DataFrame:
    groups = take.sampled
    if group is None and len(groups) > 1:
        raise ValueError(f"the take has {len(groups)} groups of sampled channels: give the index of one, 0 to {len(groups) - 1}")
    if group is not None and not 0 <= group < len(groups):
        raise ValueError(f"no group {group}: the take has {len(groups)} groups of sampled channels, counted from 0")
    return _channels(pandas, groups[group or 0] if groups else take.analog, start_s, stop_s, channels)


def _channels(
    pandas: ModuleType, analog: Analog, start_s: float | None, stop_s: float | None, channels: Channels
) -> pandas.DataFrame:
    indices = analog._indices(channels)
    names = unique_names([analog.channels[index].name for index in indices])
    frame = pandas.DataFrame(
        analog.read(start_s, stop_s, indices),
        index=pandas.Index(analog.times(start_s, stop_s), name="time_s"),
        columns=pandas.Index(names, name="channel", dtype=object if not names else None),
    )
    units = {name: analog.channels[index].unit for name, index in zip(names, indices)}
    frame.attrs = {"units": units, "rate_hz": analog.rate_hz}
    return frame


def _force_plates(
    pandas: ModuleType, take: Take, start_s: float | None = None, stop_s: float | None = None
) -> pandas.DataFrame:
    by_group: dict[int, list[ForcePlate]] = {}
    for plate in take.force_plates:
        by_group.setdefault(id(plate._analog), []).append(plate)
    # Plates that are sampled at times of their own have rows of their own.
    frames = [_loads(pandas, plates, start_s, stop_s) for plates in by_group.values() or [[]]]
    frame: pandas.DataFrame = frames[0] if len(frames) == 1 else pandas.concat(frames, axis=1).sort_index()
    units = {"force_n": "N", "moment_nm": "N m", "cop_mm": "mm", "free_moment_nm": "N m"}
    rate_hz = take.force_plates[0]._analog.rate_hz if take.force_plates else take.analog.rate_hz
    frame.attrs = {"units": units, **_axes(take), "rate_hz": rate_hz}
    return frame


def _loads(
    pandas: ModuleType, plates: list[ForcePlate], start_s: float | None, stop_s: float | None
) -> pandas.DataFrame:
    quantities = ("force_n", "moment_nm", "cop_mm", "free_moment_nm")
    columns = pandas.MultiIndex.from_product(
        [[plate.number for plate in plates], quantities, list("xyz")], names=["plate", "quantity", "axis"]
    )
    loads = read_loads(plates, start_s, stop_s)
    values = [getattr(load, quantity) for load in loads for quantity in quantities]
    time_s = loads[0].time_s if loads else np.empty(0)
    frame = pandas.DataFrame(
        np.concatenate(values, axis=1) if values else np.empty((0, 0)),
        index=pandas.Index(time_s, name="time_s"),
        columns=columns,
    )
    return frame


def _poses(
    pandas: ModuleType,
    take: Take,
    start_s: float | None = None,
    stop_s: float | None = None,
    bodies: Bodies = None,
) -> pandas.DataFrame:
    indices = take.poses._indices(bodies)
    names = unique_names([take.poses.names[index] for index in indices])
    found = take.poses.read(start_s, stop_s, indices)
    numbers = np.concatenate([found.positions_mm, found.quaternions, found.residuals_mm[:, :, None]], axis=2)
    quantities = ("x", "y", "z", "qw", "qx", "qy", "qz", "residual")
    columns: dict[tuple[str, str], Any] = {}
    for body, name in enumerate(names):
        columns |= {(name, quantity): numbers[:, body, at] for at, quantity in enumerate(quantities)}
        columns[name, "state"] = found.states[:, body]
    frame = pandas.DataFrame(columns, index=pandas.Index(found.time_s, name="time_s"))
    frame.columns = pandas.MultiIndex.from_tuples(list(columns) or [], names=["body", "quantity"])
    lengths = dict.fromkeys(("x", "y", "z", "residual"), "mm")
    states = dict(take.poses.STATES)
    frame.attrs = {"units": lengths, **_axes(take), "rate_hz": take.rate_hz, "states": states}
    return frame


def _events(pandas: ModuleType, take: Take) -> pandas.DataFrame:
    fields = {"time_s": float, "frame": "int64", "kind": str, "text": str}
    fields |= {"input": "int64", "device_ticks": "uint64", "host_ns": "uint64"}
    columns = {name: [getattr(event, name) for event in take.events] for name in fields}
    frame = pandas.DataFrame(columns).astype(fields)
    frame.attrs = {"units": {"time_s": "s", "host_ns": "ns"}, "rate_hz": take.rate_hz}
    return frame


def _subject(pandas: ModuleType, take: Take) -> pandas.DataFrame:
    skeleton = (take.subject.skeleton if take.subject else None) or {}
    bones = skeleton.get("bones") or []
    texts, numbers = ("parent", "child"), ("length_mm", "uncertainty_mm", "spread_mm")
    try:
        names = pandas.Index([bone["name"] for bone in bones], name="bone", dtype=str)
        columns = {field: [bone.get(field) for bone in bones] for field in (*texts, *numbers, "scans")}
        types = dict.fromkeys(texts, str) | dict.fromkeys(numbers, float) | {"scans": "Int64"}
        frame = pandas.DataFrame(columns, index=names).astype(types)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise TakeError(f"{take.path}: the bones of the subject's skeleton are invalid: {error!r}") from error
    name = take.subject.name if take.subject else None
    frame.attrs = {"units": "mm", "name": name, "stature_mm": skeleton.get("stature_mm")}
    return frame


_TABLES = {
    "positions": _positions,
    "analog": _analog,
    "sampled": _sampled,
    "force_plates": _force_plates,
    "poses": _poses,
    "events": _events,
    "subject": _subject,
}
