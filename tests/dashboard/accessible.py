"""Looks for faults of accessibility with axe-core (MPL-2.0), which the package axe-core-python brings."""

from importlib.resources import files

#: What axe-core calls serious or critical: it keeps people from using a page.
SEVERE = ("serious", "critical")

#: The theme in which views are looked at by all rules of axe-core. Themes differ in colours alone: in the other one the rule on the
#: colours of links applies, and contrast.js, which reads the contrast of every text in both.
THEME = "dark"
OF_COLOURS = ["link-in-text-block"]

RUN = """const done = arguments[1];
    axe.run(document, { resultTypes: ['violations'], ...arguments[0] })
        .then(({ violations }) => done(violations.map(({ id, impact, help, nodes }) => ({ id, impact, help, at: nodes.map(({ target }) => target.join(' ')).slice(0, 5) }))))
        .catch((error) => done([{ id: 'axe', impact: 'critical', help: String(error), at: [] }]))"""


def faults(browser, theme=THEME):
    """The severe faults of the page on display, as texts."""
    if browser.js("return !window.axe"):
        script = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
        # A page's policy does not apply to what the driver executes.
        browser.js(f"{script} ; window.axe = window.axe ?? axe;")
    found = browser.driver.execute_async_script(RUN, {} if theme == THEME else {"runOnly": OF_COLOURS})
    return [f"{fault['id']} ({fault['impact']}): {fault['help']}: {', '.join(fault['at'])}" for fault in found if fault["impact"] in SEVERE]
