"""Firefox for the tests: Debian's, headless, with a temporary profile, over WebDriver BiDi, which needs no other program."""

import base64
import json
import re
import subprocess
import tempfile
import threading
import time

from websocket import create_connection

#: How long Firefox may take to start, and to answer a command, in seconds.
START_S, ANSWER_S = 40.0, 20.0
DESKTOP = (1440, 900)


class Firefox:
    """What the checks of a page use of a browser; see `Browser`."""

    def __init__(self, firefox, pictures):
        self.profile = tempfile.TemporaryDirectory(prefix="mocapd-firefox-")
        self.pictures, self.messages, self.number = pictures, [], 0
        command = [firefox, "--headless", "--no-remote", "--profile", self.profile.name, "--remote-debugging-port", "0", "about:blank"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.socket = create_connection(f"{self._address()}/session", timeout=ANSWER_S, suppress_origin=True)
        # Whatever else it says must not fill the pipe.
        threading.Thread(target=self.process.stderr.read, daemon=True).start()
        self.command("session.new", capabilities={})
        self.command("session.subscribe", events=["log.entryAdded"])
        self.context = self.command("browsingContext.getTree")["contexts"][0]["context"]
        self.command("browsingContext.setViewport", context=self.context, viewport={"width": DESKTOP[0], "height": DESKTOP[1]})

    def _address(self):
        until = time.monotonic() + START_S
        for line in self.process.stderr:
            found = re.search(r"WebDriver BiDi listening on (ws://\S+)", line)
            if found:
                return found[1]
            assert time.monotonic() < until, "Firefox does not start"
        raise AssertionError("Firefox has ended")

    def close(self):
        self.socket.close()
        self.process.terminate()
        self.process.wait(timeout=ANSWER_S)
        self.profile.cleanup()

    def command(self, method, **params):
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": params}))
        while True:
            answer = json.loads(self.socket.recv())
            if answer.get("method") == "log.entryAdded":
                self.messages.append(answer["params"])
            if answer.get("id") == self.number:
                assert answer["type"] == "success", answer
                return answer["result"]

    def open(self, url):
        self.command("browsingContext.navigate", context=self.context, url=url, wait="complete")

    def js(self, script, *values):
        body = f"return JSON.stringify((function () {{ {script} }}).apply(null, JSON.parse(text)) ?? null)"
        result = self.command("script.callFunction", functionDeclaration=f"function (text) {{ {body} }}", awaitPromise=False,
                              target={"context": self.context}, arguments=[{"type": "string", "value": json.dumps(values)}])
        assert result["type"] == "success", result.get("exceptionDetails")
        return json.loads(result["result"]["value"])

    def text(self, name):
        return self.js("return document.getElementById(arguments[0])?.textContent ?? ''", name)

    def keys(self, keys):
        """Presses keys while no element has the focus."""
        self.js("document.activeElement?.blur()")
        presses = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        self.command("input.performActions", context=self.context, actions=[{"type": "key", "id": "keyboard", "actions": presses}])

    def wait(self, what, condition, seconds=30.0):
        """Waits until `condition`, a function or a script, returns a true value, and returns that value."""
        until = time.monotonic() + seconds
        while True:
            found = condition() if callable(condition) else self.js(condition)
            if found:
                return found
            assert time.monotonic() < until, f"not within {seconds:.0f} s: {what}"
            time.sleep(0.05)

    def picture(self, name, whole=False):
        origin = "document" if whole else "viewport"
        data = self.command("browsingContext.captureScreenshot", context=self.context, origin=origin)["data"]
        (self.pictures / f"{name}-firefox.png").write_bytes(base64.b64decode(data))

    def errors(self):
        """Takes the error messages of the page so far."""
        found = [entry["text"] for entry in self.messages if entry["level"] == "error"]
        self.messages = []
        return found
