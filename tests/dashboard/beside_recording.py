#!/usr/bin/env python3
"""Measures what viewers, playback and downloads cost a recording of 200 markers at 1000 Hz: frames lost, start and stop.

    tests/dashboard/beside_recording.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim

A simulated device plays over a pty. Takes are started and stopped, ten times without and ten times with the load in turn,
so that both see the same machine: four readers of the live stream, one that plays a take at its own speed by the windows that
the player requests, and one that downloads the take, as it is and as C3D, without a pause. It prints the median and the p99
of both, and their ratios; it fails if a frame was lost. `--browser` opens the pages instead of sending their requests, in headless chromium on
the same machine, which then draws five pages on its processors, too. Needs requirements.txt for that alone.
"""

import argparse
import json
import math
import multiprocessing
import shutil
import statistics
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from pathlib import Path

from checks_service import Rig

MARKERS, RATE_HZ = 200, 1000
MOTION = ("--generate", "jump:3", "--seconds", "60", "--markers", MARKERS, "--rate", RATE_HZ, "--occlusion", "0.03")
VIEWERS = 4
#: Takes in a row with the same load.
IN_A_ROW = 10
#: Length of the take that is played, and of those that are measured.
PLAYED_S, TAKE_S = 20.0, 0.4
#: The causes of lost frames in a ledger.
CAUSES = ("lost_on_link", "dropped_by_device", "lost_ring_full", "lost_other", "unknown_after_disconnect")
#: Bytes of a window that the player requests.
WINDOW_BYTES = 400_000


def post(url, body):
    request = urllib.request.Request(url, json.dumps(body).encode(), {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as response:
        return json.load(response)


def get(url):
    with urllib.request.urlopen(url, timeout=60) as response:
        return response.read()


def view(url, counts, index):
    """Reads the live stream."""
    with urllib.request.urlopen(f"{url}v1/live", timeout=60) as stream:
        while data := stream.read(16_384):
            counts[index] += len(data)


def play(url, counts, index):
    """Requests the windows of the take, each when the one before it has been played."""
    seconds = WINDOW_BYTES / (12 * MARKERS * RATE_HZ)
    due = time.monotonic()
    while True:
        for window in range(math.floor(PLAYED_S / seconds)):
            counts[index] += len(get(f"{url}v1/takes/played/window?from={window * seconds:.3f}&seconds={seconds:.3f}"))
            due = max(due + seconds, time.monotonic() - 1)
            time.sleep(max(0.0, due - time.monotonic()))


def download(url, counts, index):
    while True:
        for query in ("", "?format=c3d"):
            with urllib.request.urlopen(f"{url}v1/takes/played/download{query}", timeout=60) as stream:
                while data := stream.read(1 << 16):
                    counts[index] += len(data)


class Requests:
    """The load as requests of other processes."""

    def __init__(self, url):
        jobs = [view] * VIEWERS + [play, download]
        self.names = [f"viewer {i + 1}" for i in range(VIEWERS)] + ["player", "download"]
        self.counts = multiprocessing.Array("Q", len(jobs), lock=False)
        self.began = time.monotonic()
        self.processes = [multiprocessing.Process(target=job, args=(url, self.counts, i), daemon=True) for i, job in enumerate(jobs)]
        for process in self.processes:
            process.start()
        time.sleep(1)

    def close(self):
        """Ends them; returns what each received, in bytes per second."""
        assert all(process.is_alive() for process in self.processes), "a reader has failed: see its message above"
        took = time.monotonic() - self.began
        for process in self.processes:
            process.terminate()
            process.join()
        rates = {name: count / took for name, count in zip(self.names, self.counts)}
        assert all(rates.values()), f"nothing was received: {rates}"
        return rates


class Pages:
    """The load as pages in a browser, and a download beside them."""

    def __init__(self, url):
        from browser import Browser  # pylint: disable=import-outside-toplevel
        self.folder = tempfile.TemporaryDirectory()
        folder = Path(self.folder.name)
        self.browser = Browser(shutil.which("chromium"), shutil.which("chromedriver"), folder, folder)
        for page in [url] * VIEWERS + [f"{url}player.html?take=played"]:
            self.browser.driver.switch_to.new_window("window")
            self.browser.open(page)
        self.browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0", 60)
        self.browser.js("mocapdPlayer.changeLoop('loopFrom'); mocapdPlayer.toggle()")
        self.counts = multiprocessing.Array("Q", 1, lock=False)
        self.began = time.monotonic()
        self.process = multiprocessing.Process(target=download, args=(url, self.counts, 0), daemon=True)
        self.process.start()
        time.sleep(2)

    def close(self):
        self.process.terminate()
        self.process.join()
        self.browser.close()
        self.folder.cleanup()
        return {"download": self.counts[0] / (time.monotonic() - self.began)}


class Measured:
    """Milliseconds of starts and stops, and lost frames."""

    def __init__(self):
        self.start_ms, self.stop_ms, self.frames, self.lost = [], [], 0, Counter()

    def take(self, url, name):
        began = time.monotonic()
        post(f"{url}v1/start", {"name": name})
        self.start_ms.append(1e3 * (time.monotonic() - began))
        time.sleep(TAKE_S)
        began = time.monotonic()
        stopped = post(f"{url}v1/stop", {})
        self.stop_ms.append(1e3 * (time.monotonic() - began))
        self.add(stopped["ledger"])

    def add(self, ledger):
        """Counts the frames of a take, and those that it lost by cause."""
        assert ledger["closes"] and ledger["finished"], ledger
        self.frames += ledger["recorded"]
        self.lost.update({cause: ledger[cause] for cause in CAUSES})


def p99(values):
    return sorted(values)[math.ceil(0.99 * len(values)) - 1]


def measure(rig, repeats, load):
    url, plain, loaded, rates = rig.url, Measured(), Measured(), {}
    for row in range(math.ceil(repeats / IN_A_ROW)):
        for n in range(IN_A_ROW):
            plain.take(url, f"plain-{row}-{n}")
        reading = load(url)
        for n in range(IN_A_ROW):
            loaded.take(url, f"loaded-{row}-{n}")
        rates = reading.close()
        for path in [*rig.takes.glob("plain-*"), *rig.takes.glob("loaded-*")]:
            path.unlink()
        print(f"  {(row + 1) * IN_A_ROW} takes each", file=sys.stderr, flush=True)
    # A take of its own in which the load begins and ends.
    long = Measured()
    post(f"{url}v1/start", {"name": "long"})
    reading = load(url)
    time.sleep(PLAYED_S)
    reading.close()
    long.add(post(f"{url}v1/stop", {})["ledger"])
    return plain, loaded, long, rates


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mocapd", type=Path, required=True)
    parser.add_argument("--mocapd-sim", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=100, help="takes without the load, and takes with it")
    parser.add_argument("--browser", action="store_true", help="pages in chromium in place of their requests")
    args = parser.parse_args()
    rig = Rig(args.mocapd.resolve(), args.mocapd_sim.resolve(), motion=MOTION)
    try:
        until = time.monotonic() + 30
        while json.loads(get(f"{rig.url}v1/status"))["state"] != "armed":
            assert time.monotonic() < until, rig.logs()
            time.sleep(0.1)
        post(f"{rig.url}v1/start", {"name": "played"})
        time.sleep(PLAYED_S)
        post(f"{rig.url}v1/stop", {})
        plain, loaded, long, rates = measure(rig, args.repeats, Pages if args.browser else Requests)
    finally:
        rig.close()
    print(f"{MARKERS} markers at {RATE_HZ} Hz, {len(plain.start_ms)} takes without and {len(loaded.start_ms)} with the load")
    print("received: " + ", ".join(f"{name} {rate / 1e6:.2f} MB/s" for name, rate in rates.items()))
    for name in ("start", "stop"):
        without, beside = (getattr(measured, f"{name}_ms") for measured in (plain, loaded))
        print(f"{name}: median {statistics.median(without):.0f} ms without, {statistics.median(beside):.0f} ms with; "
              f"p99 {p99(without):.0f} and {p99(beside):.0f} ms, {p99(beside) / p99(without):.2f} times")
    beside = loaded.lost + long.lost
    for name, frames, lost in (("without", plain.frames, plain.lost), ("with", loaded.frames + long.frames, beside)):
        causes = ", ".join(f"{n} {cause}" for cause, n in lost.items() if n)
        print(f"{sum(lost.values())} frames lost beside {frames} recorded {name} the load{causes and f': {causes}'}")
    return 1 if sum(beside.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
