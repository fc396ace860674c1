"""Imports C3D files as some laboratories write them, exports them to C3D, and has ezc3d and py-c3d open that.

    python check_foreign.py --mocapd target/release/mocapd

A reader that crashes is one that fails: each runs in a process of its own. One line for each file and reader; the last
line is `N passed, N failed`; exit code 1 when one failed.

ezc3d 1.7.2 takes the number of frames from POINT:FRAMES, and where that is 65535 from the length of the file; it reads
neither the TRIAL group nor POINT:LONG_FRAMES. py-c3d 0.6.0 reads TRIAL:ACTUAL_END_FIELD, and makes of a first frame's
number beyond 16 bits one too few (65535 for 65536), so that its first frame is not compared there.
"""

import argparse
import pickle
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import foreign_c3d


def with_ezc3d(path):
    """Frames, number of the first (as the header holds it), analog samples by channel."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    points = file["data"]["points"]
    analog = file["data"]["analogs"][0]
    return points.shape[2], file["header"]["points"]["first_frame"] + 1, analog.T, points[:3, 0].T


def with_py_c3d(path):
    import c3d

    warnings.simplefilter("ignore")
    with open(path, "rb") as file:
        reader = c3d.Reader(file)
        frames = list(reader.read_frames())
        analog = [analog for _, _, analog in frames if analog.size]
        analog = np.concatenate(analog, axis=1).T if analog else np.zeros((0, 0))
        points = np.array([points[0, :3] for _, points, _ in frames])
        return len(frames), reader.first_frame, analog, points


READERS = {"ezc3d": with_ezc3d, "py-c3d": with_py_c3d}


def opened(reader, path):
    """What a reader finds, in a process of its own."""
    command = [sys.executable, __file__, "--open", reader, str(path)]
    result = subprocess.run(command, capture_output=True)
    if result.returncode != 0:
        raise RuntimeError(f"exit {result.returncode}: {result.stderr.decode()[-200:].strip()}")
    return pickle.loads(result.stdout)


def complaints(case, reader, path):
    n_frames, first_frame, analog, points = opened(reader, path)
    wrong = []
    if n_frames != case.n_frames:
        wrong.append(f"{n_frames} frames for {case.n_frames}")
    if case.first_frame <= 65535 and first_frame != case.first_frame:
        wrong.append(f"first frame {first_frame} for {case.first_frame}")
    if analog.shape != case.analog.shape and case.analog.size:
        wrong.append(f"analog samples {analog.shape} for {case.analog.shape}")
    elif case.analog.size and not np.allclose(analog, case.analog, rtol=1e-5, atol=1e-2):
        wrong.append(f"analog samples differ by {np.abs(analog - case.analog).max()}")
    time = np.arange(case.n_frames) / case.rate
    if n_frames == case.n_frames and not np.allclose(points[:, 0], 1000 * np.sin(time), atol=1e-3):
        wrong.append("positions differ")
    return wrong


def run(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"exit {result.returncode}: {result.stderr.strip()[-300:]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", type=Path)
    parser.add_argument("--open", nargs=2, metavar=("READER", "FILE"), help="open a file, for this program itself")
    arguments = parser.parse_args()
    if arguments.open:
        reader, path = arguments.open
        sys.stdout.buffer.write(pickle.dumps(READERS[reader](path)))
        return
    mocapd = arguments.mocapd.resolve()
    passed = failed = 0
    for case in foreign_c3d.cases():
        with tempfile.TemporaryDirectory() as folder:
            source, take, export = (Path(folder) / name for name in ("a.c3d", "a.take", "b.c3d"))
            source.write_bytes(case.data)
            for reader in case.readers:
                try:
                    if not take.exists():
                        run(mocapd, "import", source, "-o", take, "--lossless")
                        run(mocapd, "export", take, "-o", export)
                    wrong = complaints(case, reader, export)
                except Exception as problem:  # any failure is this file's, the others still count
                    wrong = [str(problem)]
                print(f"{'FAIL' if wrong else 'ok  '} {case.name} {reader} {'; '.join(wrong)}", flush=True)
                passed, failed = passed + (not wrong), failed + bool(wrong)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0 or passed == 0)


if __name__ == "__main__":
    main()
