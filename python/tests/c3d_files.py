"""C3D files with analog channels and force plates of known loads, byte by byte."""

import struct
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests" / "oracle"))

from foreign_c3d import FLOATS, INTEL, floats, group, parameter, texts, word, words  # noqa: E402

POINT, ANALOG, FORCE_PLATFORM, EVENT = 1, 2, 3, 4


def array(number, name, values):
    """A parameter of floats with the dimensions of an array, the first one fastest."""
    values = np.asarray(values, dtype="<f4")
    return parameter(number, name, FLOATS, list(values.shape), values.tobytes(order="F"))


def c3d_file(
    points, analog, ratio, records, *, scale=-1.0, stored="<f4", rate_hz=100.0, unit="mm", first_frame=1, fourth_words=0
):
    """The bytes of a file.

    ``points`` is [frames, markers, 3] in ``unit``, NaN for a missing sample; ``analog`` is [frames * ratio, channels], as
    it is to be stored. A ``scale`` above 0 stores integers, of points divided by it. ``fourth_words`` are those of the samples
    that are not missing, [frames, markers, 1]: the residual, and the camera mask times 256.
    """
    n_frames, n_markers, _ = points.shape
    n_channels = analog.shape[1]
    section = group(POINT, "POINT") + word(POINT, "USED", n_markers) + floats(POINT, "SCALE", [scale])
    section += floats(POINT, "RATE", [rate_hz]) + word(POINT, "FRAMES", n_frames) + texts(POINT, "UNITS", [unit])
    section += texts(POINT, "LABELS", [f"M{marker}" for marker in range(n_markers)])
    section += group(ANALOG, "ANALOG") + word(ANALOG, "USED", n_channels)
    section += floats(ANALOG, "RATE", [rate_hz * ratio]) + records + b"\0\0"
    n_blocks = -(-(len(section) + 4) // 512)
    per_frame = n_channels * ratio
    last_frame = first_frame + n_frames - 1
    header = struct.pack(
        "<BB5Hf2Hf", 2, 0x50, n_markers, per_frame, first_frame, last_frame, 0, scale, n_blocks + 2, ratio, rate_hz
    )
    data = header.ljust(512, b"\0")
    data += (struct.pack("BBBB", 1, 0x50, n_blocks, INTEL) + section).ljust(512 * n_blocks, b"\0")
    present = np.isfinite(points[:, :, :1])
    coordinates = np.where(present, points / max(scale, 0) if scale > 0 else points, 0)
    words_of_points = np.concatenate([coordinates, np.where(present, fourth_words, -1)], axis=2)
    rows = np.concatenate([words_of_points.reshape(n_frames, -1), analog.reshape(n_frames, per_frame)], axis=1)
    if scale > 0:
        rows = np.round(rows)
    # Unsigned samples wrap to the signed words of the same bits.
    data += (rows.astype(stored) if scale < 0 else (rows.astype(np.int64) & 0xFFFF).astype("<u2")).tobytes()
    return data.ljust(-(-len(data) // 512) * 512, b"\0")


def walk(n_frames, n_markers=3, rate_hz=100.0):
    """Markers that move smoothly; the second one is missing for ten frames."""
    time = np.arange(n_frames)[:, None, None] / rate_hz
    marker = np.arange(n_markers)[None, :, None]
    axis = np.arange(3)[None, None, :]
    points = 500 + 300 * marker + 200 * np.sin(2 * time + marker + axis) + 100 * axis
    points[20:30, 1] = np.nan
    return points


def channel_records(n_channels, *, labels=None, units=None, scales=None, offsets=None, gen_scale=1.0, more=b""):
    """The ANALOG group's parameters besides USED and RATE."""
    labels = labels or [f"C{channel}" for channel in range(n_channels)]
    units = units or ["V"] * n_channels
    offsets = [0] * n_channels if offsets is None else offsets
    descriptions = [f"channel {channel + 1}" for channel in range(n_channels)]
    records = texts(ANALOG, "LABELS", labels) + texts(ANALOG, "UNITS", units)
    records += texts(ANALOG, "DESCRIPTIONS", descriptions) + floats(ANALOG, "GEN_SCALE", [gen_scale])
    records += array(ANALOG, "SCALE", np.ones(n_channels) if scales is None else scales)
    return records + words(ANALOG, "OFFSET", offsets) + more


def event_records(times_s, contexts, labels):
    """The EVENT group; times count from frame number 1."""
    records = group(EVENT, "EVENT") + word(EVENT, "USED", len(times_s))
    records += texts(EVENT, "CONTEXTS", contexts) + texts(EVENT, "LABELS", labels)
    return records + array(EVENT, "TIMES", np.stack([np.zeros(len(times_s)), times_s]))


class Plate:
    """A force plate and a load that is known: a force at a point of its surface, and a moment about its normal there.

    ``centre_mm`` is the centre of the surface, in the laboratory; the plate's x is the laboratory's x turned about the
    vertical by ``turn_deg``, and its z points down. ``sensor_mm`` is ORIGIN for types 2 and 4.
    """

    SIZE_MM = (400.0, 600.0)

    def __init__(self, kind, centre_mm, turn_deg, force_n, point_mm, twist_nm, sensor_mm=(1.5, -2.5, -41.0)):
        self.kind, self.centre_mm, self.sensor_mm = kind, np.array(centre_mm), np.array(sensor_mm)
        turn = np.radians(turn_deg)
        x = np.array([np.cos(turn), np.sin(turn), 0.0])
        z = np.array([0.0, 0.0, -1.0])
        self.axes = np.stack([x, np.cross(z, x), z], axis=1)
        self.force_n, self.twist_nm = np.asarray(force_n), np.asarray(twist_nm)
        # On the surface.
        offset = np.asarray(point_mm) - self.centre_mm
        self.point_mm = np.asarray(point_mm) - (offset @ z)[:, None] * z
        # Volts to newtons and newton millimetres.
        self.calibration = np.diag([50.0, 51, 200, 9000, 9100, 4000]) + 3 * np.arange(36).reshape(6, 6) / 36

    @property
    def corners_mm(self):
        quadrants = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(self.SIZE_MM) / 2
        return self.centre_mm + quadrants @ self.axes[:, :2].T

    @property
    def moment_nm(self):
        """About the centre of the surface, in the laboratory's axes."""
        arm_m = (self.point_mm - self.centre_mm) / 1000
        return np.cross(arm_m, self.force_n) + self.free_moment_nm

    @property
    def free_moment_nm(self):
        return self.twist_nm[:, None] * self.axes[:, 2]

    def channels(self):
        """What the plate's channels are when it is loaded so, as its type defines."""
        force = self.force_n @ self.axes
        arm = (self.point_mm - self.centre_mm) @ self.axes
        twist = np.stack([0 * self.twist_nm, 0 * self.twist_nm, 1000 * self.twist_nm], axis=1)
        if self.kind == 1:
            return np.concatenate([force, arm[:, :2], twist[:, 2:]], axis=1)
        if self.kind == 3:
            return self.eight_sensors(force, arm, twist)
        moment = np.cross(self.sensor_mm + arm, force) + twist
        wrench = np.concatenate([force, moment], axis=1)
        return wrench @ np.linalg.inv(self.calibration).T if self.kind == 4 else wrench

    def eight_sensors(self, force, arm, twist):
        """Of a plate of type 3: fx12, fx34, fy14, fy23, fz1 to fz4, sensors at (+-a, +-b) and az0 below the surface."""
        a, b, az0 = self.sensor_mm
        moment = np.cross(arm + [0, 0, az0], force) + twist
        fz = force[:, 2] / 4
        about_x, about_y = moment[:, 0] / (4 * b), moment[:, 1] / (4 * a)
        split = moment[:, 2] / (2 * b)
        fx, fy = force[:, 0] / 2, force[:, 1] / 2
        vertical = [fz + about_x - about_y, fz + about_x + about_y, fz - about_x + about_y, fz - about_x - about_y]
        return np.stack([fx - split, fx + split, fy, fy, *vertical], axis=1)


def plate_records(plates, used=None, per_mm=1.0):
    """The FORCE_PLATFORM group of plates whose channels follow each other in the file, with lengths in a unit of which
    there are ``per_mm`` in a millimetre."""
    widths = [8 if plate.kind == 3 else 6 for plate in plates]
    most = max(widths)
    channel = np.zeros((most, len(plates)), dtype=int)
    for number, width in enumerate(widths):
        first = sum(widths[:number]) + 1
        channel[:width, number] = np.arange(first, first + width)
    records = group(FORCE_PLATFORM, "FORCE_PLATFORM")
    records += word(FORCE_PLATFORM, "USED", len(plates) if used is None else used)
    records += words(FORCE_PLATFORM, "TYPE", [plate.kind for plate in plates])
    records += words(FORCE_PLATFORM, "ZERO", [0, 0])
    records += array(FORCE_PLATFORM, "CORNERS", per_mm * np.stack([plate.corners_mm.T for plate in plates], axis=2))
    records += array(FORCE_PLATFORM, "ORIGIN", per_mm * np.stack([plate.sensor_mm for plate in plates], axis=1))
    data = struct.pack(f"<{channel.size}H", *channel.ravel(order="F"))
    records += parameter(FORCE_PLATFORM, "CHANNEL", 2, list(channel.shape), data)
    calibration = np.zeros((most, most, len(plates)))
    for number, plate in enumerate(plates):
        calibration[:6, :6, number] = plate.calibration if plate.kind == 4 else np.eye(6)
    # Moments are in newtons times the unit of length.
    calibration[3:6] *= per_mm
    return records + array(FORCE_PLATFORM, "CAL_MATRIX", calibration)
