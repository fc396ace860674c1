"""A browser for the tests: Debian's chromium, headless, with a temporary profile."""

import base64
import json
import tempfile
import time

from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--disable-dev-shm-usage", "--force-color-profile=srgb"]
DESKTOP, PHONE = (1440, 900), (390, 844)
#: Longer than anything takes on the slowest machine.
WAIT_S = 30.0


class Browser:
    def __init__(self, chromium, chromedriver, pictures, downloads):
        self.profile = tempfile.TemporaryDirectory(prefix="mocapd-browser-")
        self.pictures, self.downloads = pictures, downloads
        options = Options()
        options.binary_location = chromium
        for flag in [*FLAGS, f"--user-data-dir={self.profile.name}"]:
            options.add_argument(flag)
        options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(chromedriver))
        self.driver.set_script_timeout(30)
        self.size(DESKTOP)

    def close(self):
        self.driver.quit()
        self.profile.cleanup()

    def devtools(self, command, **what):
        return self.driver.execute_cdp_cmd(command, what)

    def size(self, size, scale=1):
        self.devtools("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=scale,
                      mobile=size[0] < 800)

    def media(self, **features):
        self.devtools("Emulation.setEmulatedMedia",
                      features=[{"name": name.replace("_", "-"), "value": value} for name, value in features.items()])

    def open(self, url):
        self.driver.get(url)

    def js(self, script, *values):
        return self.driver.execute_script(script, *values)

    def text(self, name):
        return self.js("return document.getElementById(arguments[0])?.textContent ?? ''", name)

    def state(self):
        return self.js("return document.getElementById('hero')?.dataset.state ?? null")

    def stats(self):
        return self.js("return window.mocapdStats")

    def click(self, name):
        self.js("document.getElementById(arguments[0]).click()", name)

    def type(self, name, text):
        """Replaces the text of a field, by key presses."""
        field = self.driver.find_element("id", name)
        field.clear()
        field.send_keys(text)

    def keys(self, keys):
        """Presses keys while no element has the focus."""
        self.js("document.activeElement?.blur()")
        ActionChains(self.driver).send_keys(keys).perform()

    def press(self, *keys):
        """Presses keys where the focus is."""
        ActionChains(self.driver).send_keys(*keys).perform()

    def wait(self, what, condition, seconds=WAIT_S):
        """Waits until `condition`, a function or a script, returns a true value, and returns that value."""
        until = time.monotonic() + seconds
        while True:
            found = condition() if callable(condition) else self.js(condition)
            if found:
                return found
            if time.monotonic() > until:
                raise AssertionError(f"not within {seconds:.0f} s: {what}")
            time.sleep(0.05)

    def wait_state(self, state, seconds=WAIT_S):
        self.wait(f"state {state} (it is {self.state()}; {self.text('answer')})", lambda: self.state() == state, seconds)

    def picture(self, name, whole=False):
        """Saves a screenshot."""
        data = self.devtools("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        path = self.pictures / f"{name}.png"
        path.write_bytes(base64.b64decode(data))
        return path

    def errors(self):
        """Errors that the browser logged since the last call: scripts, and violations of the CSP."""
        errors = [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        return [message for message in errors if "favicon.ico" not in message]

    def errors_but_refusals(self):
        """Those errors without responses that refuse a request, which browsers log as errors."""
        return [message for message in self.errors() if "status of 4" not in message]

    def json(self, url):
        """A JSON response of the service, fetched by the page."""
        return json.loads(self.driver.execute_async_script(
            "const done = arguments[1]; fetch(arguments[0]).then((r) => r.text()).then(done)", url))
