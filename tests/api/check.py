#!/usr/bin/env python3
"""Tests the HTTP API of a real service, with a simulated device, by third-party tools.

openapi-spec-validator reads /openapi.json, schemathesis sends valid and invalid requests, and promtool, if Debian's
prometheus package is installed, reads /metrics.

    check.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim [--seconds 40]
"""

import argparse
import json
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

# Streams do not end, which schemathesis does not support; tests/service/http/streams.rs tests them.
STREAMS = ["/v1/events", "/v1/live"]
# JSON Schema cannot express limits in bytes, nor whether a take name is unused.
NOT_CHECKED = "positive_data_acceptance"
# What counts as a refusal: the default, and the statuses of bodies and paths that are too long.
CONFIGURATION = """[checks.negative_data_rejection]
expected-statuses = [400, 401, 403, 404, 405, 406, 409, 413, 414, 415, 422, 428, 429, "5xx"]
"""
# All operations have their examples, and their limits are covered, within 6 s; the rest is random requests.
SECONDS_MAX = 40
SEED = 7


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--mocapd", required=True, type=Path)
    arguments.add_argument("--mocapd-sim", required=True, type=Path)
    arguments.add_argument("--seconds", type=int, default=SECONDS_MAX, help="how long schemathesis sends requests")
    options = arguments.parse_args()
    results = []
    with tempfile.TemporaryDirectory(prefix="mocapd-api-") as folder, Service(options, Path(folder)) as service:
        results.append(validate_document(service))
        results.append(check_metrics(service))
        results.append(fuzz(service, Path(folder), options.seconds))
        results.append(check_running(service))
    passed, failed = results.count(True), results.count(False)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


class Service:
    """A simulated device, and the service that records it."""

    def __init__(self, options, folder):
        self.options, self.folder, self.children = options, folder, []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.url = f"http://127.0.0.1:{free.getsockname()[1]}"

    def __enter__(self):
        pty = self.folder / "rig"
        self.start(self.options.mocapd_sim, "serve", "--generate", "jump:1", "--seconds", "3", "--loop", f"--pty={pty}")
        wait(pty.exists, "the simulated device")
        config = self.folder / "mocapd.toml"
        config.write_text(
            f"[device]\nuri = 'serial:{pty}'\n[take]\ndirectory = '{self.folder / 'takes'}'\n"
            f"[http]\nsocket = '{self.folder / 'mocapd.sock'}'\nlisten = '{self.url.removeprefix('http://')}'\n"
        )
        self.start(self.options.mocapd, "run", "--config", config)
        wait(lambda: self.get("/healthz"), "the service")
        return self

    def start(self, *command):
        log = open(self.folder / f"{Path(command[0]).name}.log", "wb")
        self.children.append(subprocess.Popen(list(map(str, command)), stdout=log, stderr=log))

    def get(self, path):
        try:
            with urllib.request.urlopen(self.url + path, timeout=10) as answer:
                return answer.read()
        except urllib.error.URLError:
            return None

    def log(self):
        return (self.folder / f"{self.options.mocapd.name}.log").read_text(errors="replace")

    def __exit__(self, *_):
        for child in reversed(self.children):
            child.terminate()
            try:
                child.wait(20)
            except subprocess.TimeoutExpired:
                child.kill()


def wait(ready, what):
    deadline = time.monotonic() + 20
    while not ready():
        if time.monotonic() > deadline:
            sys.exit(f"{what} did not start within 20 s")
        time.sleep(0.1)


def report(check, passed, details=""):
    print(f"{'good' if passed else 'BAD '}  {check}")
    if not passed:
        print(details)
    return passed


def validate_document(service):
    from openapi_spec_validator import OpenAPIV31SpecValidator

    document = json.loads(service.get("/openapi.json"))
    errors = [f"{list(error.path)}: {error.message}" for error in OpenAPIV31SpecValidator(document).iter_errors()]
    return report("/openapi.json is OpenAPI 3.1", not errors, "\n".join(errors))


def check_metrics(service):
    metrics = service.get("/metrics")
    promtool = shutil.which("promtool")
    if promtool is None:
        print("skipped: promtool (Debian package prometheus)")
        return None
    ran = subprocess.run([promtool, "check", "metrics"], input=metrics, capture_output=True)
    return report("promtool reads /metrics", ran.returncode == 0, (ran.stdout + ran.stderr).decode())


def fuzz(service, folder, seconds):
    command = [
        Path(sys.executable).with_name("schemathesis"), "--no-color", "run", service.url + "/openapi.json",
        "--url", service.url, "--exclude-checks", NOT_CHECKED, "--phases", "examples,coverage,fuzzing",
        "--max-examples", "25", "--max-time", str(seconds), "--seed", str(SEED), "--no-shrink",
        "--generation-database", "none", "--request-timeout", "30", "--continue-on-failure",
    ]
    for path in STREAMS:
        command += ["--exclude-path", path]
    (folder / "schemathesis.toml").write_text(CONFIGURATION)
    began = time.monotonic()
    ran = subprocess.run(list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=60 + 2 * seconds)
    cases = re.search(r"(\d+) generated", ran.stdout)
    what = f"schemathesis, {cases[1] if cases else '?'} requests in {time.monotonic() - began:.0f} s"
    return report(what, ran.returncode == 0 and cases is not None, ran.stdout[-12000:] + ran.stderr)


def check_running(service):
    status = json.loads(service.get("/v1/status") or "{}")
    good = status.get("state") in ("idle", "armed", "recording") and service.children[-1].poll() is None
    return report("the service is running and has not failed", good, f"{status}\n{service.log()[-4000:]}")


if __name__ == "__main__":
    main()
