"""The player against the mock: pictures, seeking, stepping, gaps, loops, keyboard, phones and themes."""

import math
import time

from accessible import faults
from browser import DESKTOP, PHONE
from checks_page import HERE, Mock
from mock_take import LOST_S, MockTake
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

CHECKS = []
#: jump-004 of the mock: its length is known.
NAME, SECONDS, MARKERS, RATE_HZ = "jump-004", 20.4, 39, 120.0

def check(name):
    """Registers a check by its name, in the order of this file."""
    return lambda body: CHECKS.append((f"the player: {name}", body)) or body


def open_take(browser, mock, name=NAME):
    browser.open(f"{mock.url}player.html?take={name}")
    browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0 && document.getElementById('view-message').hidden")


def row(browser):
    return browser.js("return window.mocapdPlayer.playback.row")


def shown(browser):
    """The row on display and the positions in the scene, as the take has them."""
    return browser.js("""const { motion } = window.mocapdPlayer;
        return [motion.row, [...motion.raw].map((v) => (Number.isNaN(v) ? null : v))]""")


def assert_shown(browser, take, expected_row):
    browser.wait(f"frame {expected_row}", lambda: shown(browser)[0] == expected_row)
    _, values = shown(browser)
    expected = [value for at in take.positions(expected_row) for value in (at or (None,) * 3)]
    assert len(values) == len(expected)
    for found, value in zip(values, expected):
        assert (found is None) == (value is None), expected_row
        assert found is None or math.isclose(found, value, rel_tol=1e-6, abs_tol=1e-3), (found, value)


@check("opens from the list of takes, with its first picture and no error")
def opens(browser, log):
    with Mock("--markers", str(MARKERS)) as mock:
        browser.open(mock.url)
        link = f"return document.querySelector('[data-take=\"{NAME}\"] a[href^=\"/player\"]')?.getAttribute('href')"
        assert browser.wait("the link", link) == f"/player.html?take={NAME}"
        browser.js(f"document.querySelector('[data-take=\"{NAME}\"] a[href^=\"/player\"]').click()")
        browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0")
        assert browser.text("take-name") == NAME
        for fact in ("0:20.400", "120 Hz", f"{MARKERS} markers", "0.5 mm"):
            assert fact in browser.text("take-facts"), browser.text("take-facts")
        log(f"first picture after {browser.js('return window.mocapdPlayer.stats.firstPictureMs'):.0f} ms")
        browser.wait("the state of the service", lambda: browser.text("service") == "Armed")
        browser.js("window.marked = 1")
        events = "return [...document.querySelectorAll('#event-list button span:last-child')].map((e) => e.textContent)"
        expected = ["mark: take off <b>", "host: the device was disconnected", "mark"]
        browser.wait("the events", lambda: browser.js(events) == expected and browser.text("events-count") == "3 events")
        browser.wait("all gaps", lambda: "reading on" not in browser.text("axis-hint"))
        assert "30 frames lost" in browser.text("axis-hint"), browser.text("axis-hint")
        browser.picture("player-dark")
        assert browser.errors() == []


@check("whatever takes longer the longer a take is comes after the frames of the first picture")
def first_requests(browser, _log):
    with Mock("--markers", str(MARKERS)) as mock:
        open_take(browser, mock)
        browser.wait("all gaps", lambda: "reading on" not in browser.text("axis-hint"))
        browser.wait("the events", lambda: browser.text("events-count") == "3 events")
        # Names from that of the take on, and when they were requested and answered, in order.
        requests = browser.js("""return performance.getEntriesByType('resource').filter(({ name }) => name.includes('/v1/takes/'))
            .map(({ name, startTime, responseEnd }) => [name.split('/').pop(), startTime, responseEnd]).sort((a, b) => a[1] - b[1])""")
        assert requests[0][0] == "overview?ends_only=true" and requests[1][0].startswith("window?from=0&"), requests
        _, _, loaded = requests[1]
        others = [request for request in requests[1:] if not request[0].startswith("window")]
        assert {name.split("?")[0] for name, _, _ in others} == {"overview", "bodies", "plates", "gaps"}, requests
        assert all(began >= loaded for _, began, _ in others), requests


@check("stepping by frame shows the decoded positions; Home, End and seconds, too")
def steps(browser, _log):
    take = MockTake(NAME, SECONDS, MARKERS, RATE_HZ)
    with Mock("--markers", str(MARKERS)) as mock:
        open_take(browser, mock)
        assert_shown(browser, take, 0)
        for expected in (1, 2, 3):
            browser.keys(Keys.ARROW_RIGHT)
            assert_shown(browser, take, expected)
        browser.keys(Keys.ARROW_LEFT)
        assert_shown(browser, take, 2)
        browser.keys(Keys.END)
        assert_shown(browser, take, take.frames - 1)
        browser.js("document.activeElement?.blur()")
        ActionChains(browser.driver).key_down(Keys.SHIFT).send_keys(Keys.ARROW_LEFT).key_up(Keys.SHIFT).perform()
        assert_shown(browser, take, take.frames - 1 - 120)
        browser.keys(Keys.HOME)
        assert_shown(browser, take, 0)
        lost = int(LOST_S[0] * RATE_HZ) + 3
        browser.js("mocapdPlayer.seek(arguments[0])", lost)
        assert_shown(browser, take, lost)
        assert browser.text("view-stats") == f"0 of {MARKERS} seen"
        assert browser.text("frame").replace("\u202f", "") == f"frame {lost + 1} of {take.frames}"
        assert browser.errors() == []


@check("playing keeps to the clock, skips no frame of a 60 Hz take, and draws quickly")
def plays(browser, log):
    with Mock("--markers", "200", "--rate", "60") as mock:
        open_take(browser, mock)
        browser.wait("what is ahead", "return mocapdPlayer.buffer.has(300)", 20)
        browser.keys(" ")
        before = "return [performance.now() / 1000, mocapdPlayer.playback.row, mocapdPlayer.stats.drawn]"
        began, first, drawn = browser.js(before)
        assert browser.text("play") == "Pause"
        time.sleep(4)
        took, rows, drawn = (now - then for now, then in zip(browser.js(before), (began, first, drawn)))
        stats = browser.js("return { ...mocapdPlayer.stats, times: null }")
        log(f"200 markers at 60 Hz: {rows / took:.1f} rows/s, {stats['skipped']} skipped, script per drawn frame p95 {stats['p95Ms']:.1f} ms")
        # Times depend on the machine, and are measured by hand on an idle one; that no frame is skipped does not.
        assert stats["skipped"] == 0, stats
        # A browser that cannot draw as often plays more slowly, a row at a time.
        assert rows / took < 1.1 * 60 and rows > 0.9 * min(0.5 * 60 * took, drawn), (rows, drawn, took)
        assert rows > 5 * took, (rows, took)
        browser.keys("k")
        before = row(browser)
        time.sleep(0.3)
        assert row(browser) == before and browser.text("play") == "Play"
        assert browser.errors() == []


@check("speeds, a loop, and the end")
def loops(browser, _log):
    with Mock("--markers", "15") as mock:
        open_take(browser, mock)
        browser.js("mocapdPlayer.seek(240)")
        browser.keys("i")
        browser.js("mocapdPlayer.seek(300)")
        browser.keys("o")
        assert browser.js("return mocapdPlayer.playback.loop") == [240, 300]
        browser.keys(Keys.ARROW_UP)
        browser.keys(Keys.ARROW_UP)
        assert browser.js("return [mocapdPlayer.playback.speed, document.getElementById('speed').value]") == [4, "4"]
        browser.js("""window.rows = []; const tick = () => { window.rows.push(mocapdPlayer.playback.row); requestAnimationFrame(tick); }; tick()""")
        browser.keys(" ")
        repeats = "return window.rows.filter((row, i) => i > 0 && row < window.rows[i - 1]).length"
        browser.wait("it repeats", lambda: browser.js(repeats) >= 3)
        rows = browser.js("return window.rows")
        played = [a for a, b in zip(rows, rows[1:]) if a != b]
        assert min(played) >= 240 and max(played) <= 300, (min(played), max(played))
        browser.keys("x")
        assert browser.js("return mocapdPlayer.playback.loop") is None
        browser.js("mocapdPlayer.seek(mocapdPlayer.playback.lastRow - 30)")
        browser.wait("the end", lambda: browser.text("play") == "Play")
        assert row(browser) == browser.js("return mocapdPlayer.playback.lastRow")
        browser.keys(" ")
        browser.wait("the beginning again", lambda: row(browser) < 1000)


def begins_gap(take, frame):
    now, before = take.positions(frame), take.positions(frame - 1)
    return any(a is None and b is not None for a, b in zip(now, before))


#: The colour of the axis at a row, in the middle of the band, as [r, g, b].
AXIS_PIXEL = """const canvas = document.getElementById('axis'); const ratio = canvas.width / canvas.clientWidth;
    const x = 9 + (arguments[0] / mocapdPlayer.playback.lastRow) * (canvas.clientWidth - 18);
    const data = canvas.getContext('2d').getImageData(Math.round((x - 2) * ratio), Math.round(arguments[1] * ratio), Math.ceil(4 * ratio), Math.ceil(12 * ratio)).data;
    return [...data].map((v, i) => [v, i]).reduce((colours, [v, i]) => { if (i % 4 === 0) colours.push(data.slice(i, i + 3).join()); return colours; }, [])"""


@check("gaps, lost frames and events are on the time axis, and can be reached by key and by pointer")
def axis(browser, _log):
    take = MockTake(NAME, SECONDS, MARKERS, RATE_HZ)
    with Mock("--markers", str(MARKERS)) as mock:
        open_take(browser, mock)
        browser.wait("all gaps", lambda: "reading on" not in browser.text("axis-hint"))
        browser.wait("the events", lambda: browser.text("events-count") == "3 events")
        colour = "return mocapdPlayer.axis.drawing.colours[arguments[0]].match(/\\d+/g).slice(0, 3).join()"
        bad, watch, mark = (browser.js(colour, name) for name in ("bad", "watch", "selected"))
        lost = int((LOST_S[0] + LOST_S[1]) / 2 * RATE_HZ)
        browser.wait("lost frames", lambda: bad in browser.js(AXIS_PIXEL, lost, 20))
        gap = next(frame for frame in range(1000, take.frames) if take.missing(frame) > 1)
        browser.wait("missing samples", lambda: watch in browser.js(AXIS_PIXEL, gap, 34))
        browser.wait("a mark", lambda: mark in browser.js(AXIS_PIXEL, int(0.4 * take.frames), 2))
        # The frames at which a gap of a marker begins, forward and back.
        begins = [frame for frame in range(1, take.frames) if begins_gap(take, frame)]
        browser.js("mocapdPlayer.seek(arguments[0])", begins[3] - 1)
        for expected in begins[3:6]:
            browser.keys("g")
            browser.wait(f"the gap at {expected}, not {row(browser)}", lambda: row(browser) == expected)
        for expected in (begins[4], begins[3], begins[2]):
            ActionChains(browser.driver).key_down(Keys.SHIFT).send_keys("g").key_up(Keys.SHIFT).perform()
            browser.wait(f"the gap at {expected}, not {row(browser)}", lambda: row(browser) == expected)
        browser.keys(Keys.END)
        browser.keys("g")
        browser.wait("the end", lambda: browser.text("axis-hint") == "no gap begins after this frame")
        browser.keys(Keys.HOME)
        for expected in (int(0.4 * take.frames), int(0.5 * take.frames)):
            browser.keys("e")
            assert row(browser) == expected
        ActionChains(browser.driver).key_down(Keys.SHIFT).send_keys("e").key_up(Keys.SHIFT).perform()
        assert row(browser) == int(0.4 * take.frames)
        element = browser.driver.find_element("id", "axis")
        width = element.size["width"]
        ActionChains(browser.driver).move_to_element_with_offset(element, 0, 0).click().perform()
        assert abs(row(browser) - take.frames / 2) < 0.01 * take.frames, row(browser)
        ActionChains(browser.driver).move_to_element(element).click_and_hold().move_by_offset(int(width / 4), 0).release().perform()
        assert abs(row(browser) - 0.75 * take.frames) < 0.02 * take.frames, row(browser)
        assert browser.js("return Number(document.getElementById('axis').getAttribute('aria-valuenow'))") == row(browser)


@check("markers are chosen for the charts, found by label, and chosen in the scene")
def charts(browser, _log):
    with Mock("--markers", str(MARKERS)) as mock:
        open_take(browser, mock)
        chosen = "return mocapdPlayer.charts.chosen"
        assert browser.js(chosen) == [0]
        image = "return document.getElementById('charts').toDataURL()"
        before = browser.wait("a chart", lambda: browser.js(image))
        browser.type("marker-filter", "knee")
        visible = "return [...document.querySelectorAll('#marker-list li:not([hidden])')].map((e) => e.querySelector('span').textContent)"
        assert browser.js(visible) == ["l_knee", "r_knee"], browser.js(visible)
        browser.js("document.querySelector('#marker-list li:not([hidden]) input').click()")
        assert browser.js(chosen) == [0, 10]
        browser.wait("another line", lambda: browser.js(image) != before)
        legend = "return [...document.querySelectorAll('#legend li')].map((e) => e.textContent)"
        assert browser.js(legend) == ["head", "l_knee"]
        browser.js("for (const i of [1, 2]) document.querySelectorAll('#marker-list input')[i].click()")
        boxes = "return [...document.querySelectorAll('#marker-list input')].filter((b) => b.disabled).length"
        assert browser.js(boxes) == MARKERS - 4, "at most four"
        browser.js("mocapdPlayer.view.select({ pinned: 13 })")
        assert browser.js(chosen) == [10, 1, 2, 13], "the one chosen first makes room"
        assert browser.errors() == []


@check("everything works by keyboard alone, and every control has a name")
def keyboard(browser, _log):
    with Mock("--markers", "15") as mock:
        open_take(browser, mock)
        assert browser.js((HERE / "unnamed.js").read_text()) == []
        # The button is disabled as long as no event is known.
        browser.wait("the events", lambda: browser.text("events-count") == "3 events")
        browser.js("document.activeElement?.blur()")
        reached = set()
        for _ in range(60):
            ActionChains(browser.driver).send_keys(Keys.TAB).perform()
            reached.add(browser.js("return document.activeElement.id || document.activeElement.className"))
        expected = {"axis", "view", "play", "back", "forward", "speed", "loop-from", "loop-to", "next-gap", "next-event",
                    "take-select", "marker-filter", "view-follow", "keys-button", "theme"}
        assert expected <= reached, expected - reached
        # The scene has its own arrow keys.
        before = row(browser)
        yaw = browser.js("return mocapdPlayer.view.camera.yaw")
        browser.driver.find_element("id", "view").send_keys(Keys.ARROW_LEFT)
        assert row(browser) == before and browser.js("return mocapdPlayer.view.camera.yaw") != yaw
        browser.driver.find_element("id", "axis").send_keys(Keys.ARROW_RIGHT)
        assert row(browser) == before + 1
        for key, expected in ((Keys.ARROW_UP, before + 2), (Keys.PAGE_UP, before + 1202), (Keys.ARROW_DOWN, before + 1201)):
            browser.driver.find_element("id", "axis").send_keys(key)
            assert row(browser) == expected and browser.js("return mocapdPlayer.playback.speed") == 1, key
        box = browser.driver.find_element("css selector", "#marker-list input")
        box.send_keys(Keys.SPACE)
        box.send_keys("i")
        assert browser.js("return mocapdPlayer.playback.loop") is not None, "keys work while a checkbox has the focus"
        box.send_keys("x")
        browser.driver.find_element("id", "marker-filter").send_keys("i k x")
        assert browser.js("return mocapdPlayer.playback.loop") is None and browser.text("play") == "Play"
        browser.keys("?")
        assert browser.js("return document.getElementById('keys').open")
        browser.js("document.getElementById('keys').close()")
        for key, name in (("t", "view-trails"), ("l", "view-labels"), ("f", "view-follow")):
            pressed = f"return document.getElementById('{name}').getAttribute('aria-pressed')"
            was = browser.js(pressed)
            browser.keys(key)
            assert browser.js(pressed) != was, key


@check("events that cannot be read are tried again; a take that was replaced meanwhile is opened again")
def read_later(browser, _log):
    with Mock("--markers", "15") as mock:
        mock.set(refuse_events=["disk", "cannot read the take: input/output error"])
        open_take(browser, mock)
        browser.wait("the notice", lambda: "input/output error" in browser.text("notice"))
        browser.wait("the list", lambda: browser.text("events-count") == "cannot be read")
        mock.set(refuse_events=None)
        browser.wait("the events, tried again", lambda: browser.text("events-count") == "3 events")
        browser.wait("no notice", "return document.getElementById('notice').hidden")

        mock.set(refuse_events=["disk", "cannot read the take: input/output error"])
        open_take(browser, mock)
        browser.wait("the list", lambda: browser.text("events-count") == "cannot be read")
        mock.set(add_take=[NAME, 6.0, "complete"], refuse_events=None)
        replaced = MockTake(NAME, 6.0, 15, RATE_HZ)
        browser.wait("the other take", f"return mocapdPlayer.playback.lastRow === {replaced.frames - 1}")
        browser.wait("its events", lambda: browser.text("events-count") == "3 events")
        browser.wait("its picture", "return document.getElementById('view-message').hidden && document.getElementById('notice').hidden")
        assert "0:06.000" in browser.text("take-facts"), browser.text("take-facts")
        browser.keys(Keys.END)
        assert_shown(browser, replaced, replaced.frames - 1)
        # A refused request is an error of the console.
        browser.errors()


@check("frames that cannot be read, a damaged take, and one that does not exist are reported")
def failures(browser, _log):
    with Mock("--markers", "15") as mock:
        mock.set(refuse_windows=["disk", "cannot read the take: input/output error"])
        browser.open(f"{mock.url}player.html?take={NAME}")
        browser.wait("the notice", lambda: "input/output error" in browser.text("notice"))
        assert browser.text("view-message") == "These frames cannot be read"
        mock.set(refuse_windows=None)
        browser.wait("the frames, tried again", "return document.getElementById('notice').hidden && mocapdPlayer.stats.drawn > 0")
        browser.open(f"{mock.url}player.html?take=none")
        browser.wait("the notice", lambda: "no take has this name" in browser.text("notice"))
        assert browser.text("view-message") == "Cannot be played"
        assert browser.js("return document.getElementById('play').disabled")
        browser.errors()
        browser.js("const s = document.getElementById('take-select'); s.value = 'jump-003'; s.dispatchEvent(new Event('change'))")
        browser.wait("another take", lambda: browser.text("take-name") == "jump-003")
        browser.wait("its picture", "return document.getElementById('view-message').hidden && document.getElementById('notice').hidden")
        assert browser.js("return location.search") == "?take=jump-003"
        mock.set(add_take=["hurt", 12.0, "damaged"])
        open_take(browser, mock, "hurt")
        browser.wait("the damage", lambda: "damaged" in browser.text("notice"))
        assert not browser.js("return document.getElementById('notice').hidden || document.getElementById('play').disabled")


@check("a long take opens as quickly as a short one, and memory is bounded while it is sought through")
def long_takes(browser, log):
    with Mock("--markers", "39") as mock:
        times = {}
        for name, seconds in (("short", 10), ("long", 3600)):
            mock.set(add_take=[name, seconds, "complete"])
            pictures = []
            for _ in range(3):
                open_take(browser, mock, name)
                pictures.append(browser.js("return mocapdPlayer.stats.firstPictureMs"))
            times[name] = sorted(pictures)[1]
        log(f"first picture: {times['short']:.0f} ms of 10 s, {times['long']:.0f} ms of an hour")
        for share in (0.5, 0.9, 0.1, 0.3, 0.7, 0.99):
            browser.js("mocapdPlayer.seek(arguments[0] * mocapdPlayer.playback.lastRow)", share)
            browser.wait("the picture", "return document.getElementById('view-message').hidden && mocapdPlayer.motion.row === mocapdPlayer.playback.row", 20)
            off = """const { motion: { box }, view: { camera } } = mocapdPlayer;
                return box && Math.hypot(...box.low.map((low, i) => (low + box.high[i]) / 2 - camera.target[i])) / camera.distanceMm"""
            browser.wait("a camera that looks at the markers", f"return (() => {{ {off} }})() < 0.05", 1)
        kept = browser.js("return mocapdPlayer.buffer.ranges().length * mocapdPlayer.buffer.windowFrames * mocapdPlayer.motion.n * 12")
        assert kept < 64e6, kept
        assert browser.errors() == []


@check("contrast, names and screenshots in both themes, on a desktop and on a phone")
def readable(browser, _log):
    contrast, unnamed = (HERE / "contrast.js").read_text(), (HERE / "unnamed.js").read_text()
    with Mock("--markers", "39") as mock:
        for scheme in ("dark", "light"):
            browser.media(prefers_color_scheme=scheme)
            for device, size, scale in (("desktop", DESKTOP, 1), ("phone", PHONE, 2)):
                browser.size(size, scale)
                open_take(browser, mock)
                browser.wait("all gaps", lambda: "reading on" not in browser.text("axis-hint"))
                browser.js("mocapdPlayer.seek(560); mocapdPlayer.changeLoop('loopFrom'); mocapdPlayer.seek(700); mocapdPlayer.changeLoop('loopTo')")
                browser.js("for (const i of [5, 10]) document.querySelectorAll('#marker-list input')[i].click()")
                time.sleep(0.4)
                assert browser.js("return document.documentElement.scrollWidth") <= size[0], device
                assert browser.js(contrast) == [], (scheme, device)
                assert browser.js(unnamed) == [], (scheme, device)
                assert faults(browser, scheme) == [], (scheme, device)
                small = """return [...document.querySelectorAll('.transport button, .view-buttons button')]
                    .filter((b) => b.checkVisibility() && b.getBoundingClientRect().height < 38).map((b) => b.textContent)"""
                assert browser.js(small) == []
                browser.picture(f"player-{device}-{scheme}", whole=True)
        browser.size(DESKTOP)
        browser.media(prefers_color_scheme="dark")
