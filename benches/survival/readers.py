"""Reads a file with the common readers of its format. It runs as a program of its own, because a reader may crash.

    python readers.py READER FILE OUT.npy

prints the messages of the reader, one per line, and writes the positions that it returned to OUT.npy (frames, markers,
3).
"""

import logging
import sys
import warnings

import numpy as np


def read_ezc3d(path):
    import ezc3d

    points = ezc3d.c3d(path)["data"]["points"]
    return points[:3].transpose(2, 1, 0)


def read_py_c3d(path):
    import c3d

    with open(path, "rb") as file:
        reader = c3d.Reader(file)
        frames = [points[:, :3] for _, points, _ in reader.read_frames()]
    return np.array(frames)


def read_mcap(path):
    from mcap.reader import make_reader

    frames = []
    with open(path, "rb") as file:
        # Frames returned before an error count.
        try:
            for _, _, message in make_reader(file).iter_messages():
                frames.append(np.frombuffer(message.data, "<f4").reshape(-1, 3))
        except Exception as error:  # noqa: BLE001
            print_error(error)
    return np.array(frames)


def read_mcap_stream(path):
    from mcap.reader import NonSeekingReader

    frames = []
    with open(path, "rb") as file:
        try:
            for _, _, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                frames.append(np.frombuffer(message.data, "<f4").reshape(-1, 3))
        except Exception as error:  # noqa: BLE001
            print_error(error)
    return np.array(frames)


def read_h5py(path):
    import h5py

    with h5py.File(path) as file:
        return file["positions"][:]


def read_pyxdf(path):
    import pyxdf

    streams, _ = pyxdf.load_xdf(path, synchronize_clocks=False, dejitter_timestamps=False)
    series = np.array(streams[0]["time_series"])
    return series.reshape(len(series), -1, 3)


READERS = {
    "c3d": [("ezc3d", read_ezc3d), ("py-c3d", read_py_c3d)],
    "mcap": [("mcap, seeking", read_mcap), ("mcap, streaming", read_mcap_stream)],
    "h5": [("h5py", read_h5py)],
    "flushed.h5": [("h5py", read_h5py)],
    "xdf": [("pyxdf", read_pyxdf)],
}


def print_error(error):
    text = " ".join(str(error).split())
    print(f"{type(error).__name__}: {text}" if text else type(error).__name__)


def main():
    name, path, out = sys.argv[1:]
    logging.basicConfig(stream=sys.stdout, level=logging.WARNING, format="%(levelname)s: %(message)s")
    warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}")
    read = {reader: function for kind in READERS.values() for reader, function in kind}[name]
    try:
        frames = read(path)
    except Exception as error:  # noqa: BLE001
        print_error(error)
        frames = np.zeros((0, 0, 3))
    np.save(out, np.asarray(frames, dtype="<f4"))


if __name__ == "__main__":
    main()
