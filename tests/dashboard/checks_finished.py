"""Timed starts and finished takes: against the mock, and one take against the daemon."""

import json

from accessible import faults
from browser import DESKTOP, PHONE
from checks_page import HERE, Mock
from checks_service import Rig
from selenium.webdriver.common.keys import Keys

CHECKS = []


def check(name):
    """Registers a check by its name, in the order of this file."""
    return lambda body: CHECKS.append((name, body)) or body


def row(name):
    return f"document.querySelector('[data-take=\"{name}\"]')"


def edit(browser, name):
    """Opens the dialog of a take by the keyboard."""
    browser.wait(f"{name} in the list", f"return {row(name)}")
    browser.js(f"{row(name)}.querySelector('button[aria-label=\"Edit {name}\"]').focus()")
    browser.press(Keys.ENTER)
    browser.wait("the dialog", "return document.getElementById('take-dialog').open")


@check("finished takes: ratings and notes in the list, edited and renamed by keyboard")
def ratings(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait("the ratings", f"return {row('jump-004')}?.textContent.includes('Good: left shoe / best of the series')")
        assert browser.js(f"return {row('jump-003')}.textContent.includes('Bad: a marker fell off')")
        assert browser.js(f"return {row('jump-001')}.textContent.includes('belongs to another take')")
        edit(browser, "jump-005")
        assert browser.js("return document.getElementById('rating-none').checked")
        browser.js("document.getElementById('rating-none').focus()")
        browser.press(Keys.ARROW_LEFT, Keys.TAB)
        assert browser.js("return document.activeElement.id") == "take-notes"
        browser.press("r s <b>bold</b>", Keys.TAB)
        assert browser.js("return document.activeElement.id") == "take-name"
        browser.press(Keys.ENTER)
        browser.wait("the dialog to close", "return !document.getElementById('take-dialog').open")
        browser.wait("the rating", f"return {row('jump-005')}.textContent.includes('Bad: r s <b>bold</b>')")
        # The dialog of a take whose notes cannot be used says so, and changes only its name.
        edit(browser, "jump-001")
        assert "another take" in browser.text("take-answer")
        assert browser.js("return document.getElementById('take-notes').matches(':disabled')")
        browser.type("take-name", "jump-002")
        browser.click("take-save")
        browser.wait("the refusal", lambda: browser.text("take-answer").startswith("Refused: a take called jump-002"))
        browser.type("take-name", "warm up")
        browser.click("take-save")
        browser.wait("the new name", f"return {row('warm up')} && !{row('jump-001')}")
        browser.press(Keys.ESCAPE)
        assert browser.errors_but_refusals() == []


@check("finished takes: the trash asks first, and gives back")
def trash(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        edit(browser, "jump-003")
        browser.click("take-trash")
        assert browser.js("return document.activeElement.id") == "take-trash-now"
        assert "jump-003" in browser.text("take-confirm-text")
        browser.click("take-keep")
        assert browser.js("return document.getElementById('take-confirm').hidden")
        browser.click("take-trash")
        browser.press(Keys.ENTER)
        browser.wait("it is gone", f"return !{row('jump-003')}")
        browser.click("trash-button")
        browser.wait("the trash", "return document.querySelectorAll('#trash-list button').length === 1")
        assert "jump-003" in browser.text("trash-list")
        browser.js("document.querySelector('#trash-list button').focus()")
        browser.press(Keys.ENTER)
        browser.wait("it is back", f"return {row('jump-003')}")
        browser.wait("the message", lambda: "jump-003 is back" in browser.text("trash-answer"))
        browser.wait("nothing left", lambda: "The trash is empty" in browser.text("trash-list"))
        browser.press(Keys.ESCAPE)
        browser.wait("the dialog to close", "return !document.getElementById('trash-dialog').open")
        assert browser.errors() == []


@check("timed starts: names, a length, a time of day, its cancellation, and why one did not take place")
def timed(browser, _log):
    with Mock() as mock:
        browser.open(mock.url)
        browser.wait_state("armed")
        browser.js("document.querySelector('#more summary').click()")
        for field, value in (("subject", "S01"), ("session", "session1"), ("trial", "jump"), ("length", "600")):
            browser.type(field, value)
        browser.keys("r")
        browser.wait_state("recording")
        browser.wait("its name", lambda: "S01_session1_jump_005" in browser.text("state-detail"))
        assert "ends by itself after 10:00.0" in browser.text("state-detail")
        browser.keys("s")
        browser.wait_state("armed")
        browser.type("length", "-1")
        browser.keys("r")
        browser.js("document.getElementById('length').value = ''")
        assert mock.status()["state"] == "armed", "an invalid length starts nothing"
        browser.js("document.getElementById('start-at').value = '14:05:09'")
        browser.keys("r")
        browser.wait("the pending start", lambda: "A take will be started at 14:05:09" in browser.text("state-detail"))
        assert "will be started at 2026-11-29T14:05:09+01:00" in browser.text("answer")
        assert browser.js("return document.getElementById('start-at').value") == ""
        browser.picture("pending-dark")
        browser.click("cancel")
        browser.wait("the cancellation", lambda: "is cancelled" in browser.text("answer"))
        browser.wait("no pending start", "return document.getElementById('cancel').hidden")
        mock.set(missed="the start at 2026-11-29T14:05:09+01:00 did not take place: the rig was not armed: arm it before")
        browser.wait("the reason", lambda: browser.text("start-notice").startswith("The start at 2026-11-29T14:05:09"))
        # Without a number, all that is held.
        assert browser.js("return document.getElementById('save-seconds').value") == ""
        browser.click("save")
        browser.wait("the saved take", lambda: "is on disk" in browser.text("answer"))
        assert "only" not in browser.text("answer"), browser.text("answer")
        assert browser.errors() == []


@check("finished takes: contrast, names and sizes of the dialogs, in both themes, on a desktop and a phone")
def dialogs_readable(browser, _log):
    contrast, unnamed = (HERE / "contrast.js").read_text(), (HERE / "unnamed.js").read_text()
    small = """return [...document.querySelectorAll('dialog[open] button, dialog[open] label.rating, dialog[open] input[type=text]')]
        .filter((b) => b.checkVisibility() && b.getBoundingClientRect().height < 40).map((b) => b.textContent)"""
    try:
        for name, size in (("desktop", DESKTOP), ("phone", PHONE)):
            browser.size(size, scale=2 if name == "phone" else 1)
            for scheme in ("dark", "light"):
                browser.media(prefers_color_scheme=scheme)
                with Mock() as mock:
                    browser.open(mock.url)
                    browser.wait("the list", f"return {row('jump-004')}")
                    browser.js("document.getElementById('more').open = true")
                    assert browser.js("return document.documentElement.scrollWidth") <= size[0]
                    assert browser.js(contrast) == [] and browser.js(unnamed) == [], scheme
                    browser.js("document.getElementById('takes-title').scrollIntoView()")
                    browser.picture(f"finished-list-{name}-{scheme}")
                    edit(browser, "jump-004")
                    found = [browser.js(contrast), browser.js(unnamed), browser.js(small), faults(browser, scheme)]
                    assert found == [[], [], [], []], f"{name}, {scheme}: {found}"
                    browser.picture(f"finished-dialog-{name}-{scheme}")
                    browser.click("take-trash")
                    assert browser.js(contrast) == [] and browser.js(small) == [] and faults(browser, scheme) == [], scheme
                    browser.picture(f"finished-confirm-{name}-{scheme}")
                    browser.click("take-trash-now")
                    browser.wait("it is gone", f"return !{row('jump-004')}")
                    browser.click("trash-button")
                    browser.wait("the trash", "return document.querySelectorAll('#trash-list button').length === 1")
                    assert browser.js(contrast) == [] and browser.js(small) == [] and faults(browser, scheme) == [], scheme
                    browser.picture(f"finished-trash-{name}-{scheme}")
    finally:
        browser.size(DESKTOP)
        browser.media(prefers_color_scheme="dark")


def checks(mocapd, mocapd_sim):
    """The checks against the daemon, each with its name."""
    return [("the daemon: a take that ends by itself is rated, renamed, trashed and restored on the page",
             lambda browser, _log: a_take(browser, mocapd, mocapd_sim))]


def a_take(browser, mocapd, mocapd_sim):
    rig = Rig(mocapd, mocapd_sim)
    try:
        browser.open(rig.url)
        browser.wait_state("armed", 20)
        browser.js("document.getElementById('more').open = true")
        for field, value in (("subject", "S01"), ("trial", "jump"), ("length", "1")):
            browser.type(field, value)
        browser.keys("r")
        browser.wait("its start", lambda: "Recording S01_jump_001" in browser.text("answer"), 15)
        browser.wait("its end", f"return {row('S01_jump_001')}?.textContent.includes('ended: length')", 20)
        edit(browser, "S01_jump_001")
        browser.click("rating-good")
        browser.type("take-notes", "left shoe")
        browser.type("take-name", "best")
        browser.click("take-save")
        browser.wait("the new name", f"return {row('best')}?.textContent.includes('Good: left shoe')")
        notes = json.loads((rig.takes / "best.notes.json").read_text())
        assert (notes["rating"], notes["text"]) == ("good", "left shoe"), notes
        edit(browser, "best")
        browser.click("take-trash")
        browser.click("take-trash-now")
        browser.wait("it is gone", f"return !{row('best')}")
        assert sorted(file.name for file in rig.takes.glob("*.*") if not file.name.startswith(".")) == []
        browser.click("trash-button")
        browser.wait("the trash", "return document.querySelectorAll('#trash-list button').length === 1")
        browser.js("document.querySelector('#trash-list button').click()")
        browser.wait("it is back", f"return {row('best')}?.textContent.includes('Good: left shoe')")
        browser.press(Keys.ESCAPE)
        assert browser.errors() == []
        # A page that is opened again offers the names of the last take.
        browser.open(rig.url)
        browser.wait("the names", "return document.getElementById('trial').value === 'jump'")
    except AssertionError as error:
        raise AssertionError(f"{error}\n{rig.logs()}") from error
    finally:
        browser.open("about:blank")
        rig.close()
