"""Looks for faults of accessibility with axe-core (MPL-2.0), which the package axe-core-python brings."""

from importlib.resources import files

#: What axe-core calls serious or critical: it keeps people from using a page.
SEVERE = ("serious", "critical")

#: The theme in which views are looked at with axe-core. Themes differ in colours alone, and contrast.js reads the contrast of
#: every text in both; axe-core takes half of the processor time of these checks.
THEME = "dark"

RUN = """const done = arguments[0];
    axe.run(document, { resultTypes: ['violations'] })
        .then(({ violations }) => done(violations.map(({ id, impact, help, nodes }) => ({ id, impact, help, at: nodes.map(({ target }) => target.join(' ')).slice(0, 5) }))))
        .catch((error) => done([{ id: 'axe', impact: 'critical', help: String(error), at: [] }]))"""


def faults(browser):
    """The severe faults of the page on display, as texts."""
    if browser.js("return !window.axe"):
        script = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
        # A page's policy does not apply to what the driver executes.
        browser.js(f"{script} ; window.axe = window.axe ?? axe;")
    found = browser.driver.execute_async_script(RUN)
    return [f"{fault['id']} ({fault['impact']}): {fault['help']}: {', '.join(fault['at'])}" for fault in found if fault["impact"] in SEVERE]
