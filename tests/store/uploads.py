"""Uploads from a rig: a service records a simulated device while its store hangs, fails and comes back."""

import json
import subprocess
import time
import urllib.error
import urllib.request

from s3 import BUCKET, free_port

# The file in the takes' folder that lists what was uploaded.
JOURNAL = ".mocapd-archive.json"


class Service:
    """A simulated device, and the service that records it and uploads to the store."""

    def __init__(self, options, folder, store, archive):
        self.mocapd, self.simulator, self.folder, self.store = options.mocapd, options.mocapd_sim, folder, store
        self.motion = ["--markers", options.markers, "--rate", options.rate]
        # For one request: a take of some seconds is sent in one.
        self.time_limit_s = max(1, round(options.seconds / 2))
        self.takes, self.pty, self.children = folder / "takes", folder / "rig", []
        self.url = f"http://127.0.0.1:{free_port()}"
        self.config = folder / "mocapd.toml"
        self.configure(archive)

    def configure(self, archive):
        self.config.write_text(
            f"[device]\nuri = 'serial:{self.pty}'\n[take]\ndirectory = '{self.takes}'\nkeep_free = '0B'\n"
            f"[archive]\nurl = 's3://{BUCKET}/rig'\n{archive}\n"
            f"[http]\nsocket = '{self.folder / 'sock'}'\nlisten = '{self.url.removeprefix('http://')}'\n"
        )

    def __enter__(self):
        self.spawn(self.simulator, "serve", "--generate", "jump:1", "--seconds", "3", *self.motion, "--loop",
                   f"--pty={self.pty}")
        until(self.pty.exists, 20)
        self.start()
        return self

    def start(self):
        self.running = self.spawn(self.mocapd, "run", "--config", self.config)
        until(lambda: self.status() is not None and self.status()["state"] == "armed", 30)

    def stop(self):
        self.running.terminate()
        self.running.wait(30)

    def spawn(self, program, *arguments):
        log = open(self.folder / f"{program.name}.log", "ab")
        environment = {**self.store.environment(), "AWS_TIMEOUT": f"{self.time_limit_s} seconds"}
        child = subprocess.Popen([str(program), *map(str, arguments)], stdout=log, stderr=log, env=environment)
        self.children.append(child)
        return child

    def __exit__(self, *_):
        self.store.mode = "works"
        for child in reversed(self.children):
            if child.poll() is None:
                child.terminate()
                try:
                    child.wait(20)
                except subprocess.TimeoutExpired:
                    child.kill()

    def ask(self, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"} if data is not None else {}
        request = urllib.request.Request(self.url + path, data, headers)
        with urllib.request.urlopen(request, timeout=30) as answer:
            return json.loads(answer.read())

    def status(self):
        try:
            return self.ask("/v1/status")
        except (urllib.error.URLError, OSError):
            return None

    def metrics(self):
        with urllib.request.urlopen(self.url + "/metrics", timeout=10) as answer:
            return answer.read().decode()

    def uploads(self):
        """The states of the uploads by take."""
        return {take["name"]: (take["upload"] or {}).get("state") for take in self.ask("/v1/takes")}

    def record(self, name, seconds):
        """Records a take, and returns its ledger."""
        self.ask("/v1/start", {"name": name})
        time.sleep(seconds)
        return self.ask("/v1/stop", {})["ledger"]

    def log(self):
        return (self.folder / f"{self.mocapd.name}.log").read_text(errors="replace")


def until(ready, seconds):
    deadline = time.monotonic() + seconds
    while not ready():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


def lossless(ledger):
    return ledger["closes"] and ledger["recorded"] > 0 and ledger["frames_sent"] == ledger["recorded"]


def check(report, options, folder, store):
    folder.mkdir()
    with Service(options, folder, store, "") as service:
        ledgers = [service.record("works", options.seconds)]
        uploaded = until(lambda: service.uploads().get("works") == "uploaded", 20)
        same = store.content("rig/works.take") == (service.takes / "works.take").read_bytes()
        report("a finished take is uploaded", uploaded and same, service.log())
        # The upload of the take before meets a store that hangs, or fails, while the next one is recorded.
        for mode in ("hangs", "fails"):
            ledgers.append(service.record(f"before-{mode}", options.seconds))
            store.mode = mode
            before = len(store.requests)
            # Requests that only ask are repeated, which takes some seconds.
            service.ask("/v1/start", {"name": f"while-{mode}"})
            until(lambda: service.status()["archive"]["error"] is not None, 40)
            time.sleep(options.seconds)
            asked = len(store.requests) - before
            status = service.status()["archive"]
            ledgers.append(service.ask("/v1/stop", {})["ledger"])
            # Or on its next attempt.
            waiting = service.uploads().get(f"before-{mode}") in ("waiting", "uploading")
            store.mode = "works"
            report(f"while the store {mode}, takes wait, and the status says why",
                   asked > 0 and waiting and status["error"] is not None and status["waiting"] >= 1, f"{asked} {status}")
            back = until(lambda: set(service.uploads().values()) == {"uploaded"}, 45)
            report(f"after a store that {mode} came back, all takes are uploaded", back, f"{service.uploads()}{service.log()}")
        lost = [ledger for ledger in ledgers if not lossless(ledger)]
        frames = sum(ledger["recorded"] for ledger in ledgers)
        report(f"none of {frames} frames was lost meanwhile", not lost, lost)
        metrics = service.metrics()
        report("the metrics count uploads", "mocapd_archive_takes_uploaded 5" in metrics and "mocapd_archive_retries_total" in metrics,
               "\n".join(line for line in metrics.splitlines() if "archive" in line))
        # A restart in the middle of an upload: the store has the object, and the journal has not.
        service.stop()
        journal = service.takes / JOURNAL
        known = json.loads(journal.read_text())
        known.pop("works")
        journal.write_text(json.dumps(known))
        (service.takes / "other.take").write_bytes((service.takes / "works.take").read_bytes())
        store.ask("PUT", f"/{BUCKET}/rig/other.take", b"something else")
        service.configure("remove_local_after = '0s'")
        service.start()
        removed = until(lambda: list(service.uploads()) == ["other"], 45)
        names = sorted(name for name in store.objects() if name.startswith("rig/"))
        kept = store.content("rig/other.take") == b"something else" and (service.takes / "other.take").exists()
        failed = service.uploads().get("other") == "failed"
        report("local copies are removed once their objects were read back", removed and len(names) == 6, f"{service.uploads()} {names}{service.log()}")
        report("an object of other content is not replaced, and its take stays", kept and failed, service.uploads())
        report("every attempt was a new object or none", names == sorted(set(names)) and not any("upload-" in name for name in names), names)
