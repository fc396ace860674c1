#!/usr/bin/env python3
"""Measures the player in headless chromium: first pictures, seeks, and script time per drawn frame.

    tests/dashboard/player_times.py --mocapd target/release/mocapd SHORT.take LONG.take

For each take: the first picture after its page was opened (median of 5), 40 seeks to frames spread over it (median and
p95), the largest response, and over five seconds of playing the rows that were skipped and the script time per drawn frame
(p95). Needs requirements.txt, and Debian's chromium with chromium-driver.
"""

import argparse
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from browser import Browser

REPEATS, SEEKS, PLAYED_S = 5, 40, 5
READY = "return window.mocapdPlayer?.stats.drawn > 0 && document.getElementById('view-message').hidden"
#: Seeks to a share of the take, and resolves to the milliseconds until its frame was drawn.
SEEK = """const [share, done] = arguments; const player = mocapdPlayer; const row = Math.floor(share * player.playback.lastRow);
    const began = performance.now(); player.seek(row);
    const look = () => (player.motion.row === row ? requestAnimationFrame(() => done(performance.now() - began)) : setTimeout(look, 1)); look();"""


def measure(browser, mocapd, take):
    process = subprocess.Popen([str(mocapd), "view", str(take)], stdout=subprocess.PIPE, text=True)
    try:
        url = process.stdout.readline().strip()
        firsts = []
        for _ in range(REPEATS):
            browser.open("about:blank")
            browser.open(url)
            browser.wait("the first picture", READY, 30)
            firsts.append(browser.js("return mocapdPlayer.stats.firstPictureMs"))
        seeks = sorted(browser.driver.execute_async_script(SEEK, (i * 0.618) % 1) for i in range(1, SEEKS + 1))
        largest = browser.js("return Math.max(...performance.getEntriesByType('resource').map((e) => e.transferSize))")
        browser.js("mocapdPlayer.seek(0)")
        time.sleep(1)
        browser.js("mocapdPlayer.stats.times.length = 0; mocapdPlayer.stats.skipped = 0; mocapdPlayer.toggle()")
        time.sleep(PLAYED_S)
        stats = browser.js("return { ...mocapdPlayer.stats, times: null }")
        print(f"{take.name}: {browser.text('take-facts')}")
        print(f"  first picture {statistics.median(firsts):.0f} ms (median of {REPEATS})")
        print(f"  seek {statistics.median(seeks):.0f} ms (median), {seeks[int(0.95 * len(seeks))]:.0f} ms (p95 of {SEEKS})")
        print(f"  largest response {largest} bytes")
        print(f"  {PLAYED_S} s played: {stats['skipped']} rows skipped, script per drawn frame p95 {stats['p95Ms']:.1f} ms")
    finally:
        browser.open("about:blank")
        process.send_signal(signal.SIGINT)
        process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mocapd", type=Path, required=True)
    parser.add_argument("takes", type=Path, nargs="+")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(shutil.which("chromium"), shutil.which("chromedriver"), Path(folder), Path(folder))
        try:
            for take in args.takes:
                measure(browser, args.mocapd.resolve(), take)
        finally:
            browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
