"""Downloads, comparisons, forces, sampled channels and rigid bodies, against the mock: on desktops and phones, in both themes."""

import itertools
import json
import math
import subprocess
import threading
import time
import urllib.request

from accessible import faults
from browser import DESKTOP, PHONE
from checks_page import HERE, Mock
from checks_player import assert_shown, open_take, row
from checks_service import Rig
from mock_rig import body_values
from mock_take import WORST, MockTake
from selenium.webdriver.common.keys import Keys

CHECKS = []
NAME, SECONDS, MARKERS, RATE_HZ = "jump-004", 20.4, 39, 120.0


def check(name):
    """Registers a check by its name, in the order of this file."""
    return lambda body: CHECKS.append((name, body)) or body


def in_both(browser, show, picture):
    """Shows a view on a desktop and a phone, in both themes, and looks at contrast, names and width."""
    contrast, unnamed = (HERE / "contrast.js").read_text(), (HERE / "unnamed.js").read_text()
    try:
        for device, size, scale in (("desktop", DESKTOP, 1), ("phone", PHONE, 2)):
            browser.size(size, scale)
            for scheme in ("dark", "light"):
                browser.media(prefers_color_scheme=scheme)
                show()
                time.sleep(0.4)
                assert browser.js("return document.documentElement.scrollWidth") <= size[0], device
                assert browser.js(contrast) == [], (scheme, device)
                assert browser.js(unnamed) == [], (scheme, device)
                assert faults(browser, scheme) == [], (scheme, device)
                browser.picture(f"{picture}-{device}-{scheme}", whole=True)
    finally:
        browser.size(DESKTOP)
        browser.media(prefers_color_scheme="dark")


LINKS = "return [...document.querySelectorAll(arguments[0])].map((a) => [a.getAttribute('href'), a.download])"


@check("downloads: a take in four formats, from the list and from the player, by keyboard")
def downloads(browser, _log):
    path = f"/v1/takes/{NAME}/download"
    expected = [[path, f"{NAME}.take"], *([f"{path}?format={f}", f"{NAME}.{f}"] for f in ("c3d", "trc", "csv"))]
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        menu = f"document.querySelector('[data-take=\"{NAME}\"] .downloads')"
        browser.wait("the list", f"return {menu}")
        assert browser.js(LINKS, f"[data-take='{NAME}'] .formats a") == expected
        browser.js(f"{menu}.querySelector('summary').focus()")
        browser.press(Keys.ENTER)
        assert browser.js(f"return {menu}.open")
        browser.press(Keys.TAB, Keys.TAB)
        assert browser.js("return document.activeElement.textContent") == "C3D"
        browser.press(Keys.ENTER)
        file = browser.downloads / f"{NAME}.c3d"
        browser.wait("the file", file.is_file)
        browser.wait("its content", lambda: file.read_text() == "mock c3d\n")
        browser.press(Keys.ESCAPE)
        assert not browser.js(f"return {menu}.open")
        assert browser.js("return document.activeElement.tagName") == "SUMMARY"
        open_take(browser, mock)
        assert browser.js(LINKS, "#downloads a") == expected
        assert browser.errors() == []


def open_comparison(browser, mock):
    mock.set(add_take=["lossless-004", SECONDS, "complete"])
    browser.open(f"{mock.url}player.html?take={NAME}&against=lossless-004")
    browser.wait("the first picture", "return window.mocapdPlayer?.stats.drawn > 0 && document.getElementById('view-message').hidden")
    browser.wait("the comparison", "return mocapdPlayer.overlays.comparison?.endRow === mocapdPlayer.overview.frames", 20)


@check("comparing: distances at the markers, a curve, and the largest error, which can be gone to")
def comparing(browser, _log):
    with Mock("--markers", str(MARKERS)) as mock:
        open_comparison(browser, mock)
        label = browser.js("return mocapdPlayer.motion.labels[arguments[0]]", WORST[1])
        text = browser.text("comparison-text")
        for part in ("Compared with lossless-004", f"largest error 9 mm: {label} at 0:02.675", "rms 0.3"):
            assert part in text, text
        browser.wait("the distances", "return mocapdPlayer.overlays.errors !== null")
        errors = browser.js("return [...mocapdPlayer.overlays.errors].filter(Number.isFinite)")
        assert len(errors) > 30 and all(abs(error - 0.3) < 1e-3 for error in errors), errors
        browser.keys("m")
        assert_shown(browser, MockTake(NAME, SECONDS, MARKERS, RATE_HZ), WORST[0])
        browser.wait("the distances there", f"return Math.abs(mocapdPlayer.overlays.errors?.[{WORST[1]}] - 9) < 1e-3")
        browser.wait("the marker", lambda: "error 9.000 mm" in browser.text("view-marker"))
        assert browser.js(f"return mocapdPlayer.overlays.comparison.classOf(9)") == 4
        curve = browser.js("return mocapdPlayer.overlays.comparison.largestByBin[Math.floor(arguments[0] / mocapdPlayer.overlays.comparison.binFrames)]", WORST[0])
        assert abs(curve - 9) < 1e-3
        # Without the other take, the player is as before.
        browser.js("const s = document.getElementById('against-select'); s.value = ''; s.dispatchEvent(new Event('change'))")
        browser.wait("no comparison", "return document.getElementById('comparison').hidden && mocapdPlayer.overlays.errors === null")
        assert browser.js("return location.search") == f"?take={NAME}"
        assert browser.errors() == []

        def show():
            open_comparison(browser, mock)
            browser.keys("m")
            browser.wait("the marker", lambda: "error 9.000 mm" in browser.text("view-marker"))
        in_both(browser, show, "compare")


def open_plates(browser, mock):
    mock.set(add_take=["plates-1", 10.0, "complete"])
    open_take(browser, mock, "plates-1")
    browser.wait("the forces", "return mocapdPlayer.overlays.forces?.curves.every((curve) => curve.some(Number.isFinite))")
    browser.js("mocapdPlayer.seek(60)")
    browser.wait("the loads", "return mocapdPlayer.overlays.forces.at(60) !== null")


@check("forces: plates with their reaction forces in the scene, and curves below the time axis")
def forces(browser, _log):
    with Mock("--markers", "15") as mock:
        open_plates(browser, mock)
        loads = browser.js("return mocapdPlayer.overlays.forces.at(60)")
        assert [round(value) for value in loads[0]["force"]] == [30, -20, 1200] and loads[0]["cop"][0] == 20.0, loads
        browser.wait("the text", lambda: browser.text("forces-text").startswith("plate 1: 1201 N · plate 2: 0 N"))
        high = browser.js("return Math.max(...mocapdPlayer.overlays.forces.curves[0].filter(Number.isFinite))")
        assert abs(high - 1205) < 1, high
        purple = "return mocapdPlayer.view.colours.force.match(/\\d+/g).slice(0, 3).map(Number)"
        drawn = """const canvas = document.getElementById('view'), wanted = arguments[0];
            const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
            let n = 0;
            for (let i = 0; i < data.length; i += 4) if (wanted.every((v, k) => Math.abs(data[i + k] - v) < 4)) n += 1;
            return n"""
        time.sleep(0.2)
        with_force = browser.js(drawn, browser.js(purple))
        browser.js("mocapdPlayer.seek(160)")
        browser.wait("the flight", lambda: browser.text("forces-text").startswith("plate 1: 36 N"))
        time.sleep(0.2)
        in_flight = browser.js(drawn, browser.js(purple))
        assert with_force > in_flight > 0, (with_force, in_flight)
        # A click on the curve goes there.
        browser.js("""const curves = document.getElementById('curves'); const box = curves.getBoundingClientRect();
            const at = { clientX: box.left + box.width / 2, clientY: box.top + 20, bubbles: true, pointerId: 1 };
            curves.setPointerCapture = () => {}; curves.dispatchEvent(new PointerEvent('pointerdown', at)); curves.dispatchEvent(new PointerEvent('pointerup', at))""")
        assert abs(row(browser) - 600) < 12, row(browser)
        open_take(browser, mock)
        browser.wait("a take without plates", "return document.getElementById('curves').hidden && document.getElementById('forces-text').hidden")
        assert browser.errors() == []
        in_both(browser, lambda: open_plates(browser, mock), "forces")


@check("sampled channels: a strip chart of each group, levels, clipping, and the ledger of the take")
def strips(browser, _log):
    with Mock("--markers", "39", "--scenario", "recording", "--sampled") as mock:
        browser.open(mock.url)
        browser.wait("the charts", "return document.querySelectorAll('#strips figure').length === 2")
        captions = "return [...document.querySelectorAll('#strips figcaption')].map((e) => e.textContent)"
        browser.wait("the ledger", lambda: all("samples" in text for text in browser.js(captions)))
        plates, electrodes = browser.js(captions)
        assert plates.startswith("Group 1 12 channels at 1000 Hz") and "none lost" in plates, plates
        assert "8 channels" in electrodes and "lost: 20 on the link" in electrodes, electrodes
        browser.wait("the clipping", lambda: "✕ clipped: EMG2" in browser.js(captions)[1])
        assert "clipped" not in browser.js(captions)[0]
        image = "return document.querySelector('#strips canvas').toDataURL()"
        before = browser.js(image)
        browser.wait("another picture", lambda: browser.js(image) != before)
        assert browser.js("return document.querySelectorAll('#strips canvas')[1].getAttribute('aria-label')") == "Group 2: clipped: EMG2"
        assert browser.errors() == []

        def show():
            browser.open(mock.url)
            browser.wait("the charts", "return document.querySelectorAll('#strips figure').length === 2")
            time.sleep(3.0)
        in_both(browser, show, "strips")
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.wait("frames", "return window.mocapdStats.frames > 3")
        assert browser.js("return document.getElementById('strips-panel').hidden"), "a device without sampled channels"


def red_pixels(browser, of):
    """Pixels of the scene with the colour of the bodies' x axes."""
    return browser.js("""const probe = document.createElement('i');
        probe.style.color = 'var(--axis-x)';
        document.body.append(probe);
        const wanted = getComputedStyle(probe).color.match(/\\d+/g).slice(0, 3).map(Number);
        probe.remove();
        const canvas = document.getElementById(arguments[0]);
        const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        let n = 0;
        for (let i = 0; i < data.length; i += 4) if (wanted.every((v, k) => Math.abs(data[i + k] - v) < 4)) n += 1;
        return n""", of)


@check("rigid bodies: axes in the live scene, and a list with their states and the shares in which they are tracked")
def live_bodies(browser, _log):
    with Mock("--markers", "39", "--bodies") as mock:
        browser.open(mock.url)
        lines = "return [...document.querySelectorAll('#bodies li')].map((e) => e.textContent)"
        browser.wait("the list", lambda: len(browser.js(lines)) == 3)
        browser.wait("the poses", lambda: browser.js(lines)[0] == "● wand · tracked · share tracked 100 %")
        assert browser.js(lines)[2] == "● body 3 · tracked · share tracked 0 %", browser.js(lines)
        browser.wait("a lost body", lambda: browser.js(lines)[1].startswith(("○ pelvis · lost · share tracked 50", "○ pelvis · lost · share tracked 49")))
        browser.wait("the count", lambda: browser.text("bodies-count") in ("2 of 3 tracked", "3 of 3 tracked"))
        browser.wait("the axes", lambda: red_pixels(browser, "view") > 20)
        assert browser.errors() == []

        def show():
            browser.open(mock.url)
            browser.wait("the poses", lambda: len(browser.js(lines)) == 3 and "pelvis · lost" in browser.js(lines)[1])
        in_both(browser, show, "bodies")
    with Mock("--markers", "15") as mock:
        browser.open(mock.url)
        browser.wait("frames", "return window.mocapdStats.frames > 3")
        assert browser.js("return document.getElementById('bodies-panel').hidden"), "a device without bodies"


def open_bodies(browser, mock):
    mock.set(add_take=["bodies-1", 10.0, "complete"])
    open_take(browser, mock, "bodies-1")
    browser.wait("the bodies", lambda: browser.text("bodies-text").startswith("3 of 3 rigid bodies tracked"))


@check("rigid bodies: in playback, each frame has its poses")
def bodies(browser, _log):
    with Mock("--markers", "15") as mock:
        open_bodies(browser, mock)
        for frame in (0, 130, 60):
            browser.js(f"mocapdPlayer.seek({frame})")
            browser.wait("the frame", lambda: row(browser) == frame)
            found = browser.js("return [...(mocapdPlayer.motion.bodies.values ?? [])]")
            expected = body_values(frame / RATE_HZ)
            assert len(found) == 27 and all(b != b or abs(a - b) < 1e-3 for a, b in zip(found, expected)), (frame, found)
            lost = frame == 130
            text = "2 of 3 rigid bodies tracked; without a pose: pelvis (lost)" if lost else "3 of 3 rigid bodies tracked"
            browser.wait("the text", lambda: browser.text("bodies-text") == text)
        browser.wait("the axes", lambda: red_pixels(browser, "view") > 20)
        open_take(browser, mock)
        browser.wait("a take without bodies", "return document.getElementById('bodies-text').hidden")
        assert browser.errors() == []
        in_both(browser, lambda: open_bodies(browser, mock), "bodies-playback")


@check("rigid bodies: a device and a take that have no markers")
def bodies_alone(browser, _log):
    with Mock("--markers", "0", "--bodies") as mock:
        browser.open(mock.url)
        browser.wait("the axes", lambda: red_pixels(browser, "view") > 20)
        open_bodies(browser, mock)
        browser.wait("the axes", lambda: red_pixels(browser, "view") > 20)
        assert browser.js("return document.getElementById('view-message').hidden")
        browser.js("mocapdPlayer.seek(130)")
        browser.wait("the text", lambda: "pelvis (lost)" in browser.text("bodies-text"))
        mock.set(add_take=["empty-1", 10.0, "complete"])
        browser.open(f"{mock.url}player.html?take=empty-1")
        browser.wait("the message", lambda: browser.text("view-message") == "This take has no markers")
        assert browser.errors() == []


#: A jump on two force plates, eight electrodes, and rigid bodies.
MOTION = ("--generate", "jump:3", "--seconds", "120", "--rate", "120", "--plates", "--emg", "8@1kHz", "--bodies", "3")


def checks(mocapd, mocapd_sim):
    """The checks against the daemon, each with its name."""
    return [("the daemon: plates and electrodes on the page, and downloads and playback beside a recording, which loses nothing",
             lambda browser, log: beside_a_recording(browser, log, mocapd, mocapd_sim))]


def status(rig):
    with urllib.request.urlopen(f"{rig.url}v1/status", timeout=5) as answer:
        return json.load(answer)


def record(browser, name):
    browser.type("name", name)
    browser.keys("r")
    browser.wait_state("recording", 15)


def download_all(rig, name, sizes, failures, until):
    """Downloads a take in all formats, one after another, again and again until a time."""
    for file_format in itertools.cycle(("c3d", "csv", "trc", "take")):
        if time.monotonic() > until or failures:
            return
        try:
            with urllib.request.urlopen(f"{rig.url}v1/takes/{name}/download?format={file_format}", timeout=60) as answer:
                sizes.append((file_format, len(answer.read())))
        except OSError as error:
            failures.append(f"{file_format}: {error}")


def beside_a_recording(browser, log, mocapd, mocapd_sim):
    rig = Rig(mocapd, mocapd_sim, motion=MOTION)
    try:
        browser.open(rig.url)
        browser.wait_state("armed", 20)
        browser.wait("the charts", "return document.querySelectorAll('#strips figure').length === 2")
        record(browser, "first")
        captions = "return [...document.querySelectorAll('#strips figcaption')].map((e) => e.textContent)"
        browser.wait("the ledger", lambda: all("none lost" in text for text in browser.js(captions)), 15)
        time.sleep(6)
        browser.picture("strips-service", whole=True)
        browser.keys("s")
        browser.wait_state("armed", 15)
        record(browser, "second")
        sizes, failures = [], []
        until = time.monotonic() + 5
        clients = [threading.Thread(target=download_all, args=(rig, "first", sizes, failures, until)) for _ in range(2)]
        for client in clients:
            client.start()
        browser.open(f"{rig.url}player.html?take=first")
        browser.wait("the forces", "return mocapdPlayer.overlays?.forces?.curves.every((curve) => curve.some(Number.isFinite))", 20)
        high, low = browser.js("""const all = mocapdPlayer.overlays.forces.curves.flatMap((curve) => [...curve]).filter(Number.isFinite);
            return [Math.max(...all), Math.min(...all)]""")
        assert 500 < high < 5000 and abs(low) < 1, (high, low)
        browser.keys(" ")
        browser.wait("it plays", "return mocapdPlayer.playback.row > 60", 15)
        browser.picture("forces-service", whole=True)
        for client in clients:
            client.join()
        assert failures == [] and len({file_format for file_format, _ in sizes}) == 4, failures
        take = status(rig)["take"]
        ledger, samples = take["ledger"], take["sample_ledger"]
        assert ledger["recorded"] == ledger["frames_sent"] > 240, ledger
        # Groups of poses have one sample a frame.
        least = {group["group"]: 400 if group["group"] >= 16 else 2000 for group in samples["groups"]}
        assert all(group["stored"] == group["taken"] > least[group["group"]] for group in samples["groups"]), samples
        log(f"{ledger['recorded']} frames recorded and none lost, beside {len(sizes)} downloads of {sorted(set(sizes))}")
        assert browser.errors() == []
        bodies_on_a_page(browser, log, rig)
    finally:
        browser.open("about:blank")
        rig.close()


#: The poses of the bodies in a row that is on display.
POSES = "return mocapdPlayer.motion.row === arguments[0] && mocapdPlayer.motion.bodies.values && [...mocapdPlayer.motion.bodies.values]"


def bodies_at(browser, frames):
    """The poses in these rows, nine numbers for each body, and the line of text of each."""
    browser.wait("the bodies", "return !document.getElementById('bodies-text').hidden", 20)
    poses, texts = [], []
    for frame in frames:
        browser.js("mocapdPlayer.seek(arguments[0])", frame)
        poses.append(browser.wait(f"frame {frame}", lambda frame=frame: browser.js(POSES, frame), 20))
        browser.wait("the text", lambda: "tracked" in browser.text("bodies-text"))
        texts.append(browser.text("bodies-text"))
    return poses, texts


def bodies_on_a_page(browser, log, rig):
    """The rigid bodies on a shared page of the first take are those of the service's player, within what the page states."""
    frames = [0, 1, 77, 300, 301, 555]
    browser.js("mocapdPlayer.playback.isPlaying && mocapdPlayer.toggle()")
    expected, texts = bodies_at(browser, frames)
    file = rig.folder / "first.html"
    exported = subprocess.run([rig.mocapd, "export", rig.takes / "first.take", "-o", file, "--json"], capture_output=True, text=True, check=True)
    page = json.loads(exported.stdout)["page"]
    browser.open(file.as_uri())
    found, found_texts = bodies_at(browser, frames)
    assert found_texts == texts, (found_texts, texts)
    worst = [0.0, 0.0]
    for all_found, all_expected in zip(found, expected):
        for at in range(0, len(all_found), 9):
            a, b = all_found[at:at + 9], all_expected[at:at + 9]
            assert a[0] == b[0], (a, b)
            if b[0] != 0:
                continue
            worst[0] = max(worst[0], math.dist(a[2:5], b[2:5]))
            # Of a quaternion and its opposite the nearer one.
            apart = min(math.dist(a[5:], b[5:]), math.dist(a[5:], [-q for q in b[5:]]))
            worst[1] = max(worst[1], math.degrees(4 * math.asin(min(1, apart / 2))))
    angles = page["angles"]
    assert 0 < worst[0] <= page["added_mm"] and 0 < worst[1] <= angles["added_degrees"] + 1e-4, (worst, page)
    assert f"{roundup(angles['added_degrees'])}°" in browser.text("foot"), browser.text("foot")
    log(f"rigid bodies on a shared page: at most {worst[0]:.3f} mm and {worst[1]:.3f}° from those of the take")
    browser.picture("shared-page-bodies", whole=True)
    assert browser.errors() == []


def roundup(value):
    """A bound with three digits, never rounded down."""
    digits = 2 - math.floor(math.log10(value))
    return f"{math.ceil(value * 10 ** digits - 1e-9) / 10 ** digits:.{max(0, digits)}f}".rstrip("0").rstrip(".")
