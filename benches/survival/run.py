"""Data loss after a crash: the frames that a killed or truncated take returns, compared with C3D, MCAP, HDF5 and XDF
files of the same motion and their common readers.

    python3 -m venv venv && venv/bin/pip install -r benches/survival/requirements.txt
    cargo build --release --workspace
    venv/bin/python benches/survival/run.py --bin target/release [--seconds 60] [--markers 64] [--part 0.6]

prints a table in Markdown. There are two tests per format: its writer is killed after the fraction --part of the
motion, and a complete file is truncated to this fraction of its bytes. The motion comes from a simulated device; the
reference is a lossless recording of it.
"""

import argparse
import json
import multiprocessing
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from readers import READERS
from writers import WRITERS

HERE = Path(__file__).parent
NAMES = {"c3d": "C3D", "mcap": "MCAP", "h5": "HDF5", "flushed.h5": "HDF5, flushed each second", "xdf": "XDF"}


@dataclass
class Motion:
    rate_hz: float
    labels: list
    frames: np.ndarray  # frames, markers, 3: millimetres


class Tools:
    def __init__(self, folder, work, args):
        self.mocapd, self.sim = Path(folder).resolve() / "mocapd", Path(folder).resolve() / "mocapd-sim"
        self.work, self.args = work, args

    def run(self, *args):
        return subprocess.run([self.mocapd, *args], cwd=self.work, capture_output=True, text=True)

    def record(self, take, *more, killed_at=None):
        """Records the simulated device; the recorder is killed `killed_at` seconds after the take appears, unless
        None."""
        serve = [self.sim, "serve", "--generate", "jump:1", "--rate", "120", "--seconds", str(self.args.seconds)]
        serve += ["--markers", str(self.args.markers)]
        sim = subprocess.Popen([*serve, "--pty"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            device = "serial:" + sim.stdout.readline().strip()
            recorder = subprocess.Popen(
                [self.mocapd, "record", "-d", device, "-o", take, *more], cwd=self.work, stdout=subprocess.DEVNULL
            )
            if killed_at is None:
                if recorder.wait() != 0:
                    sys.exit("the recording failed")
            else:
                while not (self.work / take).exists():
                    time.sleep(0.001)
                time.sleep(killed_at)
                recorder.send_signal(signal.SIGKILL)
                recorder.wait()
        finally:
            sim.kill()
            sim.wait()

    def motion(self, take):
        """Labels and frames of a take from `mocapd export`, its messages, and its exit code."""
        csv = self.work / "export.csv"
        csv.unlink(missing_ok=True)
        ran = self.run("export", take, "-o", csv.name)
        messages = [line.removeprefix(f"mocapd: {take}: ") for line in ran.stderr.splitlines()]
        lines = csv.read_text().splitlines() if csv.exists() else [""]
        labels = [cell[:-2] for cell in lines[0].split(",")[2::3]]
        cells = [[float(cell) if cell else np.nan for cell in line.split(",")[2:]] for line in lines[1:]]
        frames = np.array(cells, dtype="<f4").reshape(len(cells), -1, 3)
        return labels, frames, messages, ran.returncode


def count_frames(frames, original, tolerance_mm=0.0):
    """The number of frames that were returned, and how many of them differ from the original."""
    n = min(len(frames), len(original))
    if n == 0:
        return 0, 0
    if frames.shape[1:] != original.shape[1:]:
        return len(frames), len(frames)
    there = ~np.isnan(frames[:n]).all(axis=(1, 2))
    off_mm = np.sqrt(((frames[:n].astype(float) - original[:n].astype(float)) ** 2).sum(axis=2))
    wrong = np.nan_to_num(off_mm, nan=0.0).max(axis=1) > tolerance_mm + 1e-9
    wrong |= np.isnan(frames[:n]).any(axis=(1, 2)) & there
    return int(there.sum()) + len(frames) - n, int((wrong & there).sum()) + len(frames) - n


def read(reader, path, work):
    out = work / "read.npy"
    out.unlink(missing_ok=True)
    command = [sys.executable, HERE / "readers.py", reader, path, out]
    try:
        ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return np.zeros((0, 0, 3)), "does not finish within 60 s"
    messages = [line for line in ran.stdout.splitlines() if line.strip()]
    if ran.returncode < 0:
        messages.append(f"the process ends with {signal.Signals(-ran.returncode).name}")
    elif ran.returncode > 0:
        messages = messages[-1:]
    frames = np.load(out) if out.exists() else np.zeros((0, 0, 3))
    return frames, "; ".join(dict.fromkeys(messages)) or "nothing"


def row(name, how, reader, frames, original, message, tolerance_mm=0.0):
    back, wrong = count_frames(frames, original, tolerance_mm)
    message = message.replace("|", "/").replace(str(Path(tempfile.gettempdir())), "...")
    message = " ".join(message.split())
    if len(message) > 160:
        message = message[:157] + "..."
    print(f"| {name} | {how} | {reader} | {back} of {len(original)} | {wrong} | {message} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--bin", required=True, help="folder with mocapd and mocapd-sim")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--markers", type=int, default=64)
    parser.add_argument("--part", type=float, default=0.6)
    args = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="survival-"))
    try:
        compare(Tools(args.bin, work, args), args, work)
    finally:
        shutil.rmtree(work)


def compare(tools, args, work):
    tools.record("original.take", "--lossless")
    labels, original, _, _ = tools.motion("original.take")
    motion = Motion(120.0, labels, original)
    percent = round(100 * args.part)
    print(f"{len(original)} frames of {len(labels)} markers at 120 Hz; killed and cut at {percent} %.\n")
    print("| format | what happened | reader | frames back | of them wrong | what it says |")
    print("|---|---|---|---|---|---|")
    killed, cut = f"writer killed at {percent} %", f"cut at {percent} % of its bytes"

    tools.record("killed.take", killed_at=args.part * args.seconds)
    tools.record("whole.take")
    whole = (work / "whole.take").read_bytes()
    (work / "cut.take").write_bytes(whole[: round(args.part * len(whole))])
    tolerance_mm = json.loads(tools.run("info", "whole.take", "--json").stdout)["tolerance_mm"]
    for take, how in [("killed.take", killed), ("cut.take", cut)]:
        _, frames, messages, code = tools.motion(take)
        row("take", how, "mocapd export", frames, original, f"{'; '.join(messages)}; exit code {code}", tolerance_mm)

    spawn = multiprocessing.get_context("spawn")
    for kind, write in WRITERS.items():
        for how, killed_at in [(killed, round(args.part * len(original))), (cut, None)]:
            path = work / f"{how.split()[0]}.{kind}"
            writer = spawn.Process(target=write, args=(path, motion, killed_at))
            writer.start()
            writer.join()
            if killed_at is None:
                data = path.read_bytes()
                path.write_bytes(data[: round(args.part * len(data))])
            for reader, _ in READERS[kind]:
                if not path.exists():
                    row(NAMES[kind], how, reader, np.zeros((0, 0, 3)), original, "there is no file")
                    break
                frames, message = read(reader, path, work)
                row(NAMES[kind], how, reader, frames, original, message.replace(str(work), ""))


if __name__ == "__main__":
    main()
