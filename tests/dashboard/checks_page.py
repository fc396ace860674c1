"""The page against the mock: what it shows, what it requests, and how it handles faults."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from accessible import faults
from browser import DESKTOP, PHONE

HERE = Path(__file__).resolve().parent
CHECKS = []


def check(name):
    """Registers a check by its name, in the order of this file."""
    return lambda body: CHECKS.append((name, body)) or body


class Mock:
    """The mock as a process, so that it can be stopped, suspended and started again."""

    def __init__(self, *options, port=0):
        command = [sys.executable, str(HERE / "mock.py"), "--port", str(port), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()
        assert self.url, "the mock did not start"
        self.port = int(self.url.rstrip("/").rpartition(":")[2])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()

    def set(self, **what):
        data = json.dumps(what).encode()
        urllib.request.urlopen(urllib.request.Request(f"{self.url}mock", data=data, method="POST"), timeout=5).close()

    def status(self):
        with urllib.request.urlopen(f"{self.url}v1/status", timeout=5) as answer:
            return json.load(answer)


@check("the pure modules: streams, camera, motion, messages and metrics")
def units(browser, log):
    with Mock("--markers", "1") as mock:
        browser.open(f"{mock.url}units/")
        results = browser.wait("the tests of the modules", "return window.unitResults")
        log(f"{results['passed']} passed in the browser")
        assert not results["failed"], results["failed"]
        assert results["passed"] >= 40, results["passed"]
        browser.errors()


@check("the page loads: state, metrics and moving markers, without browser errors")
def page_loads(browser, log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.wait("the frame rate", lambda: browser.text("tile-rate").startswith("Frame rate") and "120" in browser.text("tile-rate"))
        browser.wait("sixty frames", lambda: browser.stats()["frames"] > 60)
        image = "return document.getElementById('view').toDataURL()"
        before = browser.js(image)
        browser.wait("moving markers", lambda: browser.js(image) != before)
        browser.wait("two hundred rows", "return document.querySelectorAll('#markers-body tr').length === 200")
        browser.wait("five takes", "return document.querySelectorAll('#takes li').length === 5")
        stats = browser.stats()
        log(f"mock: {stats['drawn_hz']:.1f} frames/s drawn, last byte to browser p95 {stats['latency_p95_ms']:.0f} ms")
        assert stats["markers"] == 200 and 150 < stats["seen"] <= 200, stats
        browser.picture("armed-dark")
        assert browser.errors() == []


@check("a take by keys: record, mark with text, stop; each with a message")
def by_keys(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("name", "trial-009")
        browser.type("notes", "left shoe <b>new</b>")
        mock.set(delay_s=0.8)
        browser.keys("r")
        browser.wait("the message that it waits for the disk", lambda: "first frame is on disk" in browser.text("answer"))
        assert browser.text("record") == "Starting …" and browser.js("return document.getElementById('record').disabled")
        browser.wait_state("recording")
        mock.set(delay_s=0)
        browser.wait("the response", lambda: browser.text("answer").startswith("Done: Recording trial-009"))
        browser.wait("the timer", lambda: browser.text("timer") > "0:00.5")
        browser.type("mark-text", "heel <i>strike</i>")
        browser.keys("m")
        browser.wait("the frame of the mark", lambda: "Marked at frame" in browser.text("answer"))
        event = "return document.querySelector('#events li[data-kind=mark] .message')?.textContent"
        assert browser.wait("the event", event) == "heel <i>strike</i>"
        browser.picture("recording-dark")
        browser.keys(" ")
        browser.wait_state("armed")
        browser.wait("the ledger", lambda: "trial-009 is on disk" in browser.text("answer"))
        assert browser.js("return document.getElementById('name').value") == "trial-010"
        browser.wait("the take in the list", "return document.querySelector('[data-take=\"trial-009\"]')")
        assert browser.errors() == []


@check("keys do nothing in an input field, and key repeats are ignored")
def keys_in_fields(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("notes", "rsm s r")
        browser.js("""document.activeElement.blur();
            document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'r', repeat: true, bubbles: true }))""")
        time.sleep(1)
        assert mock.status()["state"] == "armed"


@check("refusals have a message, and disarm, arm and save last work")
def refusals(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("name", "jump-003")
        browser.click("record")
        browser.wait("the refusal", lambda: browser.text("answer") == "Refused: a take called jump-003 exists: choose another name")
        browser.type("save-seconds", "3")
        browser.click("save")
        browser.wait("the saved take", lambda: "is on disk" in browser.text("answer"))
        browser.click("arm")
        browser.wait_state("idle")
        browser.wait("no metrics", lambda: "–" in browser.text("tile-rate"))
        mock.set(presence="absent", obstacle="/dev/ttyUSB0 does not exist: is the device plugged in?")
        browser.wait_state("absent")
        browser.wait("the obstacle", lambda: "is the device plugged in?" in browser.text("obstacle"))
        browser.click("arm")
        browser.wait("the reason", lambda: browser.text("answer").startswith("Refused: the device is absent"))
        browser.picture("idle-absent-dark")
        mock.set(fail="the disk failed (EIO): check it, then arm again")
        browser.wait_state("failed")
        assert "check it, then arm again" in browser.text("state-detail")
        browser.picture("failed-dark")


@check("an absent device dominates the page: missing frames, and when recording resumes")
def device_absent(browser, _log):
    with Mock("--scenario", "recording") as mock:
        browser.open(mock.url)
        browser.wait_state("recording")
        mock.set(presence="absent", obstacle="the device is absent: plug it in or switch it on")
        browser.wait_state("absent")
        assert browser.text("state") == "No device" and "No device" in browser.js("return document.title")
        browser.wait("the missing frames", lambda: "frames missing so far" in browser.text("state-detail"))
        for text in ("Recording interrupted: jump-006", "Recording resumes when the device is back"):
            assert text in browser.text("state-detail"), browser.text("state-detail")
        browser.wait("the time without data", lambda: "0:01" <= browser.text("timer") < "0:09")
        assert browser.text("timer-label") == "without data" and browser.text("record") == "Stop"
        ok_tiles = """return [...document.querySelectorAll('.tile[data-level=ok]')].map((tile) => tile.id)"""
        assert browser.js(ok_tiles) == ["tile-disk"], browser.js(ok_tiles)
        mock.set(presence="streaming", obstacle=None)
        browser.wait_state("recording")
        assert browser.js("return document.getElementById('timer-label').hidden")
        mock.set(presence="silent")
        browser.wait_state("silent")
        assert browser.text("state") == "No frames"


@check("a command whose response was lost is sent again with the same id, and executed once")
def lost_responses(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.js("""window.answers = []; const answer = document.getElementById('answer');
            new MutationObserver(() => window.answers.push(answer.textContent)).observe(answer, { childList: true })""")
        mock.set(lose_responses=2)
        browser.click("record")
        browser.wait("the response", lambda: browser.text("answer").startswith("Done: Recording"), 15)
        answers = browser.js("return window.answers")
        assert any("retrying with the same request id" in text for text in answers), answers
        started = "return document.querySelectorAll('#events li[data-kind=take-started]').length"
        browser.wait("one started take", lambda: browser.js(started) == 1)
        time.sleep(0.5)
        assert browser.js(started) == 1
        mock.set(refuse=["unavailable", "too busy: try again"])
        browser.click("record")
        browser.wait("the retry", lambda: "retrying" in browser.text("answer"))
        mock.set(refuse=None)
        browser.wait("the result", lambda: "is on disk" in browser.text("answer"))
        browser.errors()


@check("a lost connection is prominent, nothing outdated is shown as current, and it reconnects by itself")
def connection(browser, _log):
    with Mock("--scenario", "recording") as mock:
        browser.open(mock.url)
        browser.wait_state("recording")
        browser.wait("frames", lambda: browser.stats()["frames"] > 10)
        # A service that hangs sends nothing, which is harder to detect than one that is gone.
        os.kill(mock.process.pid, signal.SIGSTOP)
        browser.wait_state("lost", 6)
        assert "last known" in browser.text("state-detail") and browser.text("timer") == ""
        browser.wait("no value", "return [...document.querySelectorAll('.tile .value')].every((v) => v.textContent === '–')")
        browser.wait("the message over the view", lambda: browser.text("view-message") == "No connection")
        assert browser.js("return ['record', 'arm', 'mark', 'save'].every((id) => document.getElementById(id).disabled)")
        browser.picture("lost-dark")
        os.kill(mock.process.pid, signal.SIGCONT)
        browser.wait_state("recording")
        before = browser.stats()["frames"]
        browser.wait("frames again", lambda: browser.stats()["frames"] > before + 10)
        port = mock.port
    browser.wait_state("lost", 6)
    with Mock(port=port):
        browser.wait_state("armed")
        before = browser.stats()["frames"]
        browser.wait("frames of the new service", lambda: browser.stats()["frames"] > before + 10)
        browser.wait("the restart", "return document.getElementById('events').textContent.includes('was restarted')")
    browser.errors()


@check("events during a lost connection are delivered after it, once each")
def events_resume(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        n = "return document.querySelectorAll('#events li').length"
        browser.wait("the events so far", lambda: browser.js(n) == 2)
        mock.set(cut_streams=time.time())
        mock.set(fail="one")
        mock.set(fail="two")
        browser.wait("both", lambda: browser.js(n) == 4)
        time.sleep(1.5)
        messages = "return [...document.querySelectorAll('#events .message')].map((m) => m.textContent)"
        assert browser.js(messages)[:2] == ["two", "one"] and browser.js(n) == 4, browser.js(messages)
        browser.errors()


@check("a frozen view is marked as outdated")
def frozen(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 30)
        mock.set(frozen=True)
        browser.wait("the message", lambda: browser.text("view-message").startswith("No frame for"))
        assert browser.js("return document.getElementById('view').classList.contains('stale')")
        mock.set(frozen=False)
        browser.wait("no message", "return document.getElementById('view-message').hidden")


@check("a token: login, a wrong token, and a session that ends while the page is open")
def token(browser, _log):
    with Mock("--token", "0123456789abcdef") as mock:
        browser.open(mock.url)
        assert browser.driver.current_url.endswith("/login"), browser.driver.current_url
        browser.driver.find_element("name", "token").send_keys("0123456789abcdef\n")
        browser.wait_state("armed")
        mock.set(log_out=True)
        browser.wait("the dialog", "return document.getElementById('login').open")
        browser.type("token", "wrong")
        browser.js("document.querySelector('#login-form button').click()")
        browser.wait("the message", lambda: browser.text("login-answer") == "Wrong token.")
        browser.type("token", "0123456789abcdef\n")
        browser.wait("the dialog to close", "return !document.getElementById('login').open")
        before = browser.stats()["frames"]
        mock.set(cut_streams=time.time())
        browser.wait("frames again", lambda: browser.stats()["frames"] > before + 30)
        browser.errors()


@check("the table of markers: worst first, sorted by a column, and a row highlights its marker")
def markers_table(browser, _log):
    with Mock("--markers", "39") as mock:
        browser.open(mock.url)
        shares = "return [...document.querySelectorAll('#markers-body td:nth-child(2)')].map((c) => parseFloat(c.textContent))"
        browser.wait("rows", lambda: len(browser.js(shares)) == 39)
        found = browser.js(shares)
        assert found == sorted(found), found
        head = "document.querySelectorAll('#markers-head button')"
        browser.js(f"{head}[0].click()")
        names = "return [...document.querySelectorAll('#markers-body th')].map((c) => c.textContent)"
        assert browser.js(names)[0].endswith("head"), browser.js(names)[:3]
        assert browser.js("return document.querySelector('#markers-head th').ariaSort") == "ascending"
        browser.wait("frames", lambda: browser.stats()["frames"] > 3)
        browser.js("document.querySelector('#markers-body tr:nth-child(3) button').click()")
        label = browser.js("return document.querySelector('#markers-body tr:nth-child(3) button').textContent")
        browser.wait("the name in the view", lambda: browser.text("view-marker").startswith(label))
        assert browser.js("return document.querySelector('#markers-body tr:nth-child(3)').classList.contains('selected')")


@check("the view by mouse and keys: it zooms, and stops following the markers")
def view_control(browser, _log):
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 3)
        follow = "return document.getElementById('view-follow').getAttribute('aria-pressed')"
        assert browser.js(follow) == "true"
        scale = browser.text("view-scale")
        browser.driver.find_element("id", "view").send_keys("-" * 12)
        browser.wait("a wider grid", lambda: browser.text("view-scale") != scale)
        assert browser.js(follow) == "false"
        browser.keys("f")
        assert browser.js(follow) == "true"
        browser.keys("l")
        assert browser.js("return document.getElementById('view-labels').getAttribute('aria-pressed')") == "true"


@check("contrast of every text, and a name of every control, in both themes and all states")
def readable(browser, _log):
    contrast, unnamed = (HERE / "contrast.js").read_text(), (HERE / "unnamed.js").read_text()
    for scheme in ("dark", "light"):
        browser.media(prefers_color_scheme=scheme)
        for scenario in ("armed", "recording", "lossy", "absent", "recording-absent", "failed"):
            with Mock("--scenario", scenario, "--markers", "39") as mock:
                browser.open(mock.url)
                browser.wait("the state", lambda: browser.state() != "waiting")
                browser.wait("rows", "return document.querySelectorAll('#markers-body tr').length === 39")
                browser.wait("takes", "return document.querySelectorAll('#takes li').length > 0")
                assert browser.js(contrast) == [], f"{scheme}, {scenario}"
                assert browser.js(unnamed) == [], f"{scheme}, {scenario}"
                assert faults(browser, scheme) == [], f"{scheme}, {scenario}"
                browser.picture(f"{scenario}-{scheme}")
    # What is looked for is found.
    browser.js("document.querySelector('main').append(document.createElement('button'))")
    assert [fault.split()[0] for fault in faults(browser)] == ["button-name"], faults(browser)
    browser.media(prefers_color_scheme="dark")


@check("a phone: nothing wider than the screen, buttons large enough for a finger")
def phone(browser, _log):
    browser.size(PHONE, scale=2)
    try:
        with Mock("--scenario", "recording") as mock:
            browser.open(mock.url)
            browser.wait_state("recording")
            browser.wait("rows", "return document.querySelectorAll('#markers-body tr').length === 200")
            assert browser.js("return document.documentElement.scrollWidth") <= PHONE[0]
            cut = """return [...document.querySelectorAll('.scroll, .tile *, .take-text, button')]
                .filter((e) => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline')
                .map((e) => e.textContent.slice(0, 60))"""
            assert browser.js(cut) == [], browser.js(cut)
            small = """return [...document.querySelectorAll('#controls button, #record, #view ~ div button, #takes .button')]
                .filter((b) => b.checkVisibility() && b.getBoundingClientRect().height < 40).map((b) => b.textContent)"""
            assert browser.js(small) == []
            browser.picture("phone-dark")
            browser.picture("phone-dark-whole", whole=True)
    finally:
        browser.size(DESKTOP)


@check("colour is never alone: screenshots with colour vision deficiencies, and states that differ in lightness")
def colours(browser, _log):
    lightness = {}
    titles = {"armed": "Armed", "recording": "Recording", "recording-absent": "No device", "failed": "Failed"}
    for scenario, word in titles.items():
        with Mock("--scenario", scenario) as mock:
            browser.open(mock.url)
            browser.wait_state(scenario.split("-")[-1])
            lightness[scenario] = browser.js("""const [r, g, b] = getComputedStyle(document.getElementById('hero'))
                .backgroundColor.match(/[\\d.]+/g).map(Number); return 0.2126 * r + 0.7152 * g + 0.0722 * b""")
            shown = browser.js("return [document.getElementById('state').textContent, document.title]")
            assert shown[0] == word and word in shown[1], shown
            browser.wait("markers", lambda: scenario not in ("armed", "recording") or browser.stats()["frames"] > 40)
            for vision in ("deuteranopia", "protanopia", "tritanopia", "achromatopsia"):
                browser.devtools("Emulation.setEmulatedVisionDeficiency", type=vision)
                browser.picture(f"{scenario}-{vision}")
            browser.devtools("Emulation.setEmulatedVisionDeficiency", type="none")
    values = sorted(lightness.values())
    assert min(b - a for a, b in zip(values, values[1:])) > 12, lightness


@check("reduced motion is respected")
def reduced_motion(browser, _log):
    browser.media(prefers_color_scheme="dark", prefers_reduced_motion="reduce")
    try:
        with Mock("--scenario", "recording") as mock:
            browser.open(mock.url)
            browser.wait_state("recording")
            assert browser.js("return document.getAnimations().length") == 0
    finally:
        browser.media(prefers_color_scheme="dark")


@check("a hidden page holds no stream, and catches up when it is visible again")
def hidden(browser, _log):
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 3)
        browser.wait("two events", "return document.querySelectorAll('#events li').length === 2")
        browser.js("""Object.defineProperty(document, 'hidden', { value: true, configurable: true });
            document.dispatchEvent(new Event('visibilitychange'))""")
        time.sleep(0.5)
        before = browser.stats()["frames"]
        mock.set(fail="while the page was hidden")
        time.sleep(1)
        assert browser.stats()["frames"] == before
        n = "return document.querySelectorAll('#events li').length"
        assert browser.js(n) == 2
        browser.js("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
        browser.wait("frames again", lambda: browser.stats()["frames"] > before + 10)
        browser.wait("the event from meanwhile", lambda: browser.js(n) == 3)
