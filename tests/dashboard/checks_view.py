"""The player on real takes: `mocapd view`, and a shared page that is opened from disk."""

import csv
import json
import math
import os
import signal
import struct
import subprocess
import tempfile
import time
from pathlib import Path

from accessible import faults
from browser import Browser
from firefox import Firefox
from selenium.webdriver.common.keys import Keys


def checks(mocapd):
    """The checks, each with its name."""
    return [("the player: mocapd view plays a take and a motion file, with their exact positions",
             lambda browser, log: view(browser, log, mocapd)),
            ("the player: a shared page plays from disk, within the stated tolerance, and loads nothing",
             lambda browser, log: shared_page(browser, log, mocapd))]


def firefox_checks(mocapd, firefox, pictures):
    """The shared page in Firefox, which shares nothing with Chromium."""
    def check(_browser, log):
        browser = Firefox(firefox, pictures)
        try:
            shared_page(browser, log, mocapd)
        finally:
            browser.close()
    return [("the player: a shared page plays from disk in Firefox, too", check)]


class Files:
    """A folder with a take, its original as CSV, and its page."""

    def __init__(self, mocapd):
        self.temporary = tempfile.TemporaryDirectory(prefix="view-")
        self.folder = Path(self.temporary.name)
        run(mocapd, "demo", "--seconds", "4s", "--out", self.folder / "demo")
        self.take = next(self.folder.glob("demo/*.take"))
        self.csv = self.take.with_suffix(".csv")
        self.page = self.folder / "jump.html"
        self.report = json.loads(run(mocapd, "export", self.take, "-o", self.page, "--json"))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.temporary.cleanup()

    def frames(self):
        """The positions of the take as mocapd exports them: by frame a list of numbers, None where missing."""
        with self.csv.open(newline="") as table:
            rows = list(csv.reader(table))[1:]
        # The shortest text of an f32, and so that f32 again.
        return [[struct.unpack("f", struct.pack("f", float(cell)))[0] if cell else None for cell in row[2:]] for row in rows]


def run(program, *args):
    done = subprocess.run([str(program), *map(str, args)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def shown(browser, row):
    """The positions in the scene at a row."""
    browser.wait(f"frame {row}", lambda: browser.js("return mocapdPlayer.motion.row") == row)
    return browser.js("return [...mocapdPlayer.motion.raw].map((v) => (Number.isNaN(v) ? null : v))")


def furthest(found, expected):
    """The largest 3D distance of two frames; their gaps must be the same."""
    assert [value is None for value in found] == [value is None for value in expected]
    apart = [math.dist(found[i:i + 3], expected[i:i + 3]) for i in range(0, len(found), 3) if found[i] is not None]
    return max(apart, default=0.0)


def view(browser, log, mocapd):
    with Files(mocapd) as files:
        process = subprocess.Popen([str(mocapd), "view", str(files.take), str(files.csv)], stdout=subprocess.PIPE, text=True)
        try:
            url = process.stdout.readline().strip()
            browser.open(url)
            browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0 && document.getElementById('view-message').hidden")
            assert "token" not in browser.driver.current_url, "the address bar shows no token"
            frames = files.frames()
            for row in (0, 1, 100, len(frames) - 1):
                browser.js("mocapdPlayer.seek(arguments[0])", row)
                assert furthest(shown(browser, row), frames[row]) == 0, row
            browser.keys(Keys.HOME)
            browser.keys(" ")
            browser.wait("it plays", "return mocapdPlayer.playback.row > 60")
            browser.keys(" ")
            log(f"first picture after {browser.js('return mocapdPlayer.stats.firstPictureMs'):.0f} ms")
            browser.picture("view-take")
            options = "return [...document.getElementById('take-select').options].map((o) => o.value)"
            assert browser.js(options) == [files.take.stem, files.csv.name]
            browser.js("const s = document.getElementById('take-select'); s.selectedIndex = 1; s.dispatchEvent(new Event('change'))")
            browser.wait("the other file", lambda: browser.text("take-name") == files.csv.name)
            browser.js("mocapdPlayer.seek(77)")
            assert furthest(shown(browser, 77), frames[77]) == 0
            browser.driver.refresh()
            browser.wait("the page again", lambda: browser.text("take-name") == files.csv.name)
            assert browser.errors() == []
            browser.js("sessionStorage.clear()")
            browser.driver.refresh()
            browser.wait("a request for the token", "return document.getElementById('login').open")
            assert "mocapd view" in browser.text("login-text")
            browser.errors()
        finally:
            browser.open("about:blank")
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=10) == 0


def shared_page(browser, log, mocapd):
    with Files(mocapd) as files:
        size, bound = os.path.getsize(files.page), 3 * os.path.getsize(files.take) + 150_000
        assert size <= bound, (size, bound)
        browser.open(files.page.as_uri())
        browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0 && document.getElementById('view-message').hidden")
        frames = files.frames()
        added = files.report["page"]["added_mm"]
        worst = 0.0
        for row in range(0, len(frames), 7):
            browser.js("mocapdPlayer.seek(arguments[0])", row)
            worst = max(worst, furthest(shown(browser, row), frames[row]))
        assert 0 < worst <= added, (worst, added)
        stated = files.report["page"]["tolerance_mm"]
        assert f"at most {stated:g} mm" in browser.text("foot"), browser.text("foot")
        browser.keys(Keys.HOME)
        browser.keys(" ")
        time.sleep(2)
        stats = browser.js("return { ...mocapdPlayer.stats, row: mocapdPlayer.playback.row, times: null }")
        assert stats["row"] > 120, stats
        assert browser.js("return performance.getEntriesByType('resource').map((e) => e.name)") == []
        log(f"{size} bytes of at most {bound}; furthest position {worst:.3f} mm of {added} mm added; "
            f"script per drawn frame p95 {stats['p95Ms']:.1f} ms")
        if isinstance(browser, Browser):
            assert faults(browser) == []
        browser.picture("shared-page", whole=True)
        assert browser.errors() == []
