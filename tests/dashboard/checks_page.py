"""The page against the mock: what it shows, what it asks for, and what it does when things go wrong."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from browser import DESKTOP, PHONE

HERE = Path(__file__).resolve().parent
CHECKS = []


def check(words):
    """A check with its name, in the order in which they stand here."""
    return lambda body: CHECKS.append((words, body)) or body


class Mock:
    """The mock as a process of its own, so that it can be stopped, silenced and started again."""

    def __init__(self, *options, port=0):
        command = [sys.executable, str(HERE / "mock.py"), "--port", str(port), *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()
        assert self.url, "the mock did not begin"
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


@check("the pure modules: streams, camera, motion, words and figures")
def units(browser, log):
    with Mock("--markers", "1") as mock:
        browser.open(f"{mock.url}units/")
        results = browser.wait("the tests of the modules", "return window.unitResults")
        log(f"{results['passed']} passed in the browser")
        assert not results["failed"], results["failed"]
        assert results["passed"] >= 40, results["passed"]
        browser.complaints()


@check("the first look: state, figures, markers that move, and nothing that the browser complains about")
def first_look(browser, log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.wait("the frame rate", lambda: browser.text("tile-rate").startswith("Frame rate") and "120" in browser.text("tile-rate"))
        browser.wait("sixty frames", lambda: browser.stats()["frames"] > 60)
        look = "return document.getElementById('view').toDataURL()"
        before = browser.js(look)
        browser.wait("markers that move", lambda: browser.js(look) != before)
        browser.wait("two hundred rows", "return document.querySelectorAll('#markers-body tr').length === 200")
        browser.wait("five takes", "return document.querySelectorAll('#takes li').length === 5")
        stats = browser.stats()
        log(f"mock: {stats['drawn_hz']:.1f} frames/s drawn, last byte to browser p95 {stats['latency_p95_ms']:.0f} ms")
        assert stats["markers"] == 200 and 150 < stats["seen"] <= 200, stats
        browser.picture("armed-dark")
        assert browser.complaints() == []


@check("a take by keys: record, mark with words, stop; each answered in words")
def by_keys(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("name", "trial-009")
        browser.type("notes", "left shoe <b>new</b>")
        mock.set(delay_s=0.8)
        browser.keys("r")
        browser.wait("that it waits for the disk", lambda: "first frame is on disk" in browser.text("answer"))
        assert browser.text("record") == "Starting …" and browser.js("return document.getElementById('record').disabled")
        browser.wait_state("recording")
        mock.set(delay_s=0)
        browser.wait("the answer", lambda: browser.text("answer").startswith("Done: Recording trial-009"))
        browser.wait("a running time", lambda: browser.text("timer") > "0:00.5")
        browser.type("mark-text", "heel <i>strike</i>")
        browser.keys("m")
        browser.wait("the mark's row", lambda: "Marked at row" in browser.text("answer"))
        event = "return document.querySelector('#events li[data-kind=mark] .message')?.textContent"
        assert browser.wait("the event", event) == "heel <i>strike</i>"
        browser.picture("recording-dark")
        browser.keys(" ")
        browser.wait_state("armed")
        browser.wait("the ledger", lambda: "trial-009 is on disk" in browser.text("answer"))
        assert browser.js("return document.getElementById('name').value") == "trial-010"
        browser.wait("the take in the list", "return document.querySelector('[data-take=\"trial-009\"]')")
        assert browser.complaints() == []


@check("keys do nothing where somebody writes, and held down they are one press")
def keys_in_fields(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("notes", "rsm s r")
        browser.js("""document.activeElement.blur();
            document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'r', repeat: true, bubbles: true }))""")
        time.sleep(1)
        assert mock.status()["state"] == "armed"


@check("refusals are said in words, and disarm, arm and save last work")
def refusals(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.type("name", "jump-003")
        browser.click("record")
        browser.wait("the refusal", lambda: browser.text("answer") == "Refused: a take called jump-003 exists: choose another name")
        browser.type("save-seconds", "3")
        browser.click("save")
        browser.wait("the take of what was held", lambda: "is on disk" in browser.text("answer"))
        browser.click("arm")
        browser.wait_state("idle")
        browser.wait("no figures", lambda: "–" in browser.text("tile-rate"))
        mock.set(presence="absent", obstacle="/dev/ttyUSB0 does not exist: is the device plugged in?")
        browser.wait_state("absent")
        browser.wait("the obstacle", lambda: "is the device plugged in?" in browser.text("obstacle"))
        browser.click("arm")
        browser.wait("why not", lambda: browser.text("answer").startswith("Refused: the device is not there"))
        browser.picture("idle-absent-dark")
        mock.set(fail="the disk failed (EIO): look at it, then arm again")
        browser.wait_state("failed")
        assert "look at it, then arm again" in browser.text("what")
        browser.picture("failed-dark")


@check("a device that is away is the loudest thing on the page, with what it costs and how it goes on")
def device_away(browser, _log):
    with Mock("--scenario", "recording") as mock:
        browser.open(mock.url)
        browser.wait_state("recording")
        mock.set(presence="absent", obstacle="the device is away: plug it in or switch it on")
        browser.wait_state("absent")
        assert browser.text("state") == "No device" and "No device" in browser.js("return document.title")
        browser.wait("the frames that are missing", lambda: "frames missing so far" in browser.text("what"))
        for words in ("Recording waits: jump-006", "Recording resumes when the device is back"):
            assert words in browser.text("what"), browser.text("what")
        browser.wait("the time without data", lambda: "0:01" <= browser.text("timer") < "0:09")
        assert browser.text("timer-what") == "without data" and browser.text("record") == "Stop"
        green = """return [...document.querySelectorAll('.tile[data-level=ok]')].map((tile) => tile.id)"""
        assert browser.js(green) == ["tile-disk"], browser.js(green)
        mock.set(presence="streaming", obstacle=None)
        browser.wait_state("recording")
        assert browser.js("return document.getElementById('timer-what').hidden")
        mock.set(presence="silent")
        browser.wait_state("silent")
        assert browser.text("state") == "No frames"


@check("an order whose answer was lost is given again under the same id, and carried out once")
def lost_answers(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.js("""window.answers = []; const answer = document.getElementById('answer');
            new MutationObserver(() => window.answers.push(answer.textContent)).observe(answer, { childList: true })""")
        mock.set(lose_answers=2)
        browser.click("record")
        browser.wait("the answer of the first", lambda: browser.text("answer").startswith("Done: Recording"), 15)
        answers = browser.js("return window.answers")
        assert any("asking again under the same id" in words for words in answers), answers
        started = "return document.querySelectorAll('#events li[data-kind=take-started]').length"
        browser.wait("one beginning", lambda: browser.js(started) == 1)
        time.sleep(0.5)
        assert browser.js(started) == 1
        mock.set(refuse=["unavailable", "too busy: try again"])
        browser.click("record")
        browser.wait("that it asks again", lambda: "asking again" in browser.text("answer"))
        mock.set(refuse=None)
        browser.wait("that it was done", lambda: "is on disk" in browser.text("answer"))
        browser.complaints()


@check("a connection that is lost is said loudly, shows nothing old as new, and comes back by itself")
def connection(browser, _log):
    with Mock("--scenario", "recording") as mock:
        browser.open(mock.url)
        browser.wait_state("recording")
        browser.wait("frames", lambda: browser.stats()["frames"] > 10)
        # A service that hangs says nothing, which is worse than one that is gone.
        os.kill(mock.process.pid, signal.SIGSTOP)
        browser.wait_state("lost", 6)
        assert "last known" in browser.text("what") and browser.text("timer") == ""
        browser.wait("no figure", "return [...document.querySelectorAll('.tile .value')].every((v) => v.textContent === '–')")
        browser.wait("no picture", lambda: browser.text("view-message") == "No connection")
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
        browser.wait("frames of the new one", lambda: browser.stats()["frames"] > before + 10)
        browser.wait("that it is another", "return document.getElementById('events').textContent.includes('started anew')")
    browser.complaints()


@check("events that came while the connection was cut come after it, once each")
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
        words = "return [...document.querySelectorAll('#events .message')].map((m) => m.textContent)"
        assert browser.js(words)[:2] == ["two", "one"] and browser.js(n) == 4, browser.js(words)
        browser.complaints()


@check("a picture that stands still is not taken for a live one")
def frozen(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 30)
        mock.set(frozen=True)
        browser.wait("that it is old", lambda: browser.text("view-message").startswith("No frame for"))
        assert browser.js("return document.getElementById('view').classList.contains('old')")
        mock.set(frozen=False)
        browser.wait("that it is not", "return document.getElementById('view-message').hidden")


@check("a token: the way in, a wrong one, and a session that ends while the page is open")
def token(browser, _log):
    with Mock("--token", "0123456789abcdef") as mock:
        browser.open(mock.url)
        assert browser.driver.current_url.endswith("/login"), browser.driver.current_url
        browser.driver.find_element("name", "token").send_keys("0123456789abcdef\n")
        browser.wait_state("armed")
        mock.set(log_out=True)
        browser.wait("the question", "return document.getElementById('login').open")
        browser.type("token", "wrong")
        browser.js("document.querySelector('#login-form button').click()")
        browser.wait("that it is wrong", lambda: browser.text("login-answer") == "Wrong token.")
        browser.type("token", "0123456789abcdef\n")
        browser.wait("no question", "return !document.getElementById('login').open")
        before = browser.stats()["frames"]
        mock.set(cut_streams=time.time())
        browser.wait("frames again", lambda: browser.stats()["frames"] > before + 30)
        browser.complaints()


@check("the markers' table: worst first, sorted by a column, and a row points the marker out")
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
        assert browser.js("return document.querySelector('#markers-body tr:nth-child(3)').classList.contains('chosen')")


@check("the view by mouse and keys: it turns, zooms and lets go of the markers")
def hands(browser, _log):
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 3)
        follow = "return document.getElementById('view-follow').getAttribute('aria-pressed')"
        assert browser.js(follow) == "true"
        scale = browser.text("view-scale")
        browser.driver.find_element("id", "view").send_keys("-" * 12)
        browser.wait("wider squares", lambda: browser.text("view-scale") != scale)
        assert browser.js(follow) == "false"
        browser.keys("f")
        assert browser.js(follow) == "true"
        browser.keys("l")
        assert browser.js("return document.getElementById('view-labels').getAttribute('aria-pressed')") == "true"


@check("contrast of every text, and a name for everything that can be operated, in both themes and all states")
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
                browser.picture(f"{scenario}-{scheme}")
    browser.media(prefers_color_scheme="dark")


@check("a phone: nothing wider than the screen, buttons as large as a finger")
def phone(browser, _log):
    browser.size(PHONE, scale=2)
    try:
        with Mock("--scenario", "recording") as mock:
            browser.open(mock.url)
            browser.wait_state("recording")
            browser.wait("rows", "return document.querySelectorAll('#markers-body tr').length === 200")
            assert browser.js("return document.documentElement.scrollWidth") <= PHONE[0]
            small = """return [...document.querySelectorAll('#controls button, #record, #view ~ div button, #takes .button')]
                .filter((b) => b.getBoundingClientRect().height < 40).map((b) => b.textContent)"""
            assert browser.js(small) == []
            browser.picture("phone-dark")
            browser.picture("phone-dark-whole", whole=True)
    finally:
        browser.size(DESKTOP)


@check("colour is never alone: pictures as colour-blind people see them, and states that differ in lightness")
def colours(browser, _log):
    lightness = {}
    words_of = {"armed": "Armed", "recording": "Recording", "recording-absent": "No device", "failed": "Failed"}
    for scenario, word in words_of.items():
        with Mock("--scenario", scenario) as mock:
            browser.open(mock.url)
            browser.wait_state(scenario.split("-")[-1])
            lightness[scenario] = browser.js("""const [r, g, b] = getComputedStyle(document.getElementById('hero'))
                .backgroundColor.match(/[\\d.]+/g).map(Number); return 0.2126 * r + 0.7152 * g + 0.0722 * b""")
            words = browser.js("return [document.getElementById('state').textContent, document.title]")
            assert words[0] == word and word in words[1], words
            browser.wait("markers", lambda: scenario not in ("armed", "recording") or browser.stats()["frames"] > 40)
            for vision in ("deuteranopia", "protanopia", "tritanopia", "achromatopsia"):
                browser.devtools("Emulation.setEmulatedVisionDeficiency", type=vision)
                browser.picture(f"{scenario}-{vision}")
            browser.devtools("Emulation.setEmulatedVisionDeficiency", type="none")
    values = sorted(lightness.values())
    assert min(b - a for a, b in zip(values, values[1:])) > 12, lightness


@check("who asked for calm gets it")
def calm(browser, _log):
    browser.media(prefers_color_scheme="dark", prefers_reduced_motion="reduce")
    try:
        with Mock("--scenario", "recording") as mock:
            browser.open(mock.url)
            browser.wait_state("recording")
            assert browser.js("return document.getAnimations().length") == 0
    finally:
        browser.media(prefers_color_scheme="dark")


@check("a page that nobody sees holds no stream, and knows what happened when it is looked at again")
def hidden(browser, _log):
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait("frames", lambda: browser.stats()["frames"] > 3)
        browser.wait("two events", "return document.querySelectorAll('#events li').length === 2")
        browser.js("""Object.defineProperty(document, 'hidden', { value: true, configurable: true });
            document.dispatchEvent(new Event('visibilitychange'))""")
        time.sleep(0.5)
        before = browser.stats()["frames"]
        mock.set(fail="while nobody looked")
        time.sleep(1)
        assert browser.stats()["frames"] == before
        n = "return document.querySelectorAll('#events li').length"
        assert browser.js(n) == 2
        browser.js("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
        browser.wait("frames again", lambda: browser.stats()["frames"] > before + 10)
        browser.wait("what happened meanwhile", lambda: browser.js(n) == 3)
