#!/usr/bin/env python3
"""A mock of the service's HTTP API, for work on the page and for its tests. Plain Python, nothing to install.

    tests/dashboard/mock.py                                # http://127.0.0.1:8820, 200 markers, armed
    tests/dashboard/mock.py --scenario lossy --markers 39
    tests/dashboard/mock.py --token secret                 # requires a login

`POST /mock` with JSON sets faults (see FAULTS in mock_rig.py) or the state (`{"fail": "reason"}`).
"""

import argparse
import contextlib
import json
import math
import secrets
import struct
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from mock_rig import FAULTS, Refused, Rig, body_values
from mock_take import MockTake

HERE = Path(__file__).resolve().parent
#: The folders served, by path: the page, and the tests of its modules.
FOLDERS = {"/": HERE.parents[1] / "web", "/units/": HERE / "units"}
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
         ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml", ".png": "image/png"}
LOGIN = b"""<!doctype html><title>mocapd: log in</title><form method="post" action="/login">
<label>Token <input type="password" name="token" required autofocus></label><button>Log in</button></form>"""
CODES = {"invalid": 400, "not_found": 404, "conflict": 409, "exists": 409, "device": 503, "disk": 507,
         "unavailable": 503, "internal": 500}


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    rig = token = None

    def log_message(self, *_):
        pass

    def handle(self):
        """Ignores a browser that disconnects."""
        with contextlib.suppress(ConnectionError):
            super().handle()

    def reply(self, code, body, kind="application/json", extra=()):
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(code)
        for name, value in (("Content-Type", kind), ("Content-Length", str(len(data))), ("Cache-Control", "no-store"),
                            ("Content-Security-Policy", "default-src 'self'"), *extra):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def is_authorized(self):
        return self.token is None or f"mocapd_session={self.rig.cookie}" in self.headers.get("Cookie", "")

    def do_GET(self):
        url = urlsplit(self.path)
        if url.path == "/login":
            return self.reply(200, LOGIN, "text/html; charset=utf-8")
        if not self.is_authorized() and "text/html" in self.headers.get("Accept", ""):
            return self.reply(303, b"", extra=[("Location", "/login")])
        if not url.path.startswith("/v1/"):
            folder, _, name = url.path.rpartition("/")
            file = FOLDERS.get(folder + "/", HERE / "nowhere") / (name or "index.html")
            if file.is_file():
                return self.reply(200, file.read_bytes(), TYPES.get(file.suffix, "application/octet-stream"))
            return self.reply(404, {"kind": "not_found", "message": f"there is no {url.path}"})
        if not self.is_authorized():
            return self.reply(401, {"kind": "unauthorized", "message": "no valid session or token: log in"})
        if url.path == "/v1/live":
            return self.live()
        if url.path == "/v1/events":
            return self.events()
        with self.rig.lock:
            if url.path == "/v1/status":
                return self.reply(200, self.rig.status())
            if url.path == "/v1/quality":
                return self.reply(200, self.rig.quality())
            if url.path == "/v1/takes":
                limit = int(parse_qs(url.query).get("limit", ["50"])[0])
                return self.reply(200, self.rig.takes[:limit])
            if url.path == "/v1/trash":
                return self.reply(200, [trashed for trashed, _ in self.rig.trash])
        if url.path.startswith("/v1/takes/") and url.path.endswith("/download"):
            name, file_format = unquote(url.path.split("/")[3]), parse_qs(url.query).get("format", ["take"])[0]
            return self.reply(200, f"mock {file_format}\n".encode(), "application/octet-stream",
                               [("Content-Disposition", f'attachment; filename="{name}.{file_format}"')])
        if url.path.startswith("/v1/takes/"):
            return self.playback(url)
        return self.reply(404, {"kind": "not_found", "message": f"there is no {url.path}"})

    def playback(self, url):
        """The overview, a window or the gaps of a take in the list."""
        name, what = unquote(url.path.split("/")[3]), url.path.split("/")[-1]
        query = {key: values[0] if key in ("against", "ends_only") else float(values[0]) for key, values in parse_qs(url.query).items()}
        rig = self.rig
        with rig.lock:
            rig.requests.append(self.path)
            found = next((take for take in rig.takes if take["name"] == name), None)
            refused = rig.faults["refuse_windows"] if what == "window" else None
            if what == "overview" and query.get("ends_only") != "true":
                refused = rig.faults["refuse_events"]
        if found is None or found["is_open"]:
            return self.reply(404, {"kind": "not_found", "message": "no take has this name: see /v1/takes"})
        if refused:
            return self.reply(CODES[refused[0]], {"kind": refused[0], "message": refused[1]})
        def mock_take(called):
            return MockTake(called, found["seconds"] or 12.5, len(rig.body.labels), rig.rate_hz, damaged=found["health"] == "damaged")
        take = mock_take(name)
        if what == "overview":
            return self.reply(200, take.overview(query.get("ends_only") != "true"))
        if what == "gaps":
            return self.reply(200, take.gaps(query.get("from", 0.0)))
        if what == "difference":
            return self.reply(200, take.difference(mock_take(query["against"]), query.get("from", 0.0)))
        if what == "plates":
            return self.reply(200, take.plates())
        if what == "bodies":
            return self.reply(200, take.bodies())
        if what == "poses":
            data = take.body_poses(query.get("from", 0.0), query.get("seconds", 4.0), int(query.get("every", 1)))
            return self.reply(200, data, "application/octet-stream")
        if what == "forces":
            data = take.forces(query.get("from", 0.0), query.get("seconds", 4.0), int(query.get("every", 1)))
            return self.reply(200, data, "application/octet-stream")
        if what == "window":
            data = take.window(query.get("from", 0.0), query.get("seconds", 4.0), int(query.get("every", 1)))
            return self.reply(200, data, "application/octet-stream")
        return self.reply(404, {"kind": "not_found", "message": f"there is no {url.path}"})

    def do_POST(self):
        data = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        rig, path = self.rig, urlsplit(self.path).path
        if path == "/login":
            return self.login(parse_qs(data.decode()).get("token", [""])[0])
        body = json.loads(data or b"{}")
        if path == "/mock":
            with rig.lock:
                if "fail" in body:
                    rig.fail(body.pop("fail"))
                if body.pop("log_out", False):
                    rig.cookie = secrets.token_hex(8)
                if "add_take" in body:
                    name, seconds, health = body.pop("add_take")
                    rig.takes.insert(0, rig.new_take(name, int(time.time() * 1000), seconds, health))
                rig.missed = body.pop("missed", rig.missed)
                rig.set_faults({key: value for key, value in body.items() if key in FAULTS})
            return self.reply(200, {})
        if not self.is_authorized():
            return self.reply(401, {"kind": "unauthorized", "message": "no valid session or token: log in"})
        time.sleep(rig.faults["delay_s"])
        with rig.lock:
            key = body.get("request_id")
            if key not in rig.replies:
                rig.replies[key] = self.execute(path, body)
            if rig.faults["lose_responses"] > 0:
                rig.faults["lose_responses"] -= 1
                return self.truncate_reply()
            code, answer = rig.replies[key]
            if answer.get("kind") == "unavailable":
                del rig.replies[key]
            return self.reply(code, answer)

    def truncate_reply(self):
        """Sends a truncated response: without any response browsers repeat the request by themselves."""
        self.send_response(200)
        self.send_header("Content-Length", "1000")
        self.end_headers()
        self.close_connection = True

    def login(self, token):
        if token != self.token:
            return self.reply(401, {"kind": "unauthorized", "message": "wrong token"})
        cookie = f"mocapd_session={self.rig.cookie}; Path=/; HttpOnly; SameSite=Strict"
        return self.reply(303, b"", extra=[("Set-Cookie", cookie), ("Location", "/")])

    def execute(self, path, body):
        rig = self.rig
        calls = {"/v1/arm": rig.arm, "/v1/disarm": rig.disarm, "/v1/start": rig.start, "/v1/stop": rig.stop,
                 "/v1/mark": rig.mark, "/v1/save-last": rig.save_last, "/v1/cancel": rig.cancel}
        of_take = {"notes": rig.edit_notes, "rename": rig.rename, "trash": rig.trash_take, "restore": rig.restore}
        try:
            if rig.faults["refuse"]:
                raise Refused(*rig.faults["refuse"])
            if path.startswith("/v1/takes/") and path.endswith("/verify"):
                return 200, self.verify(unquote(path.split("/")[3]))
            if path.startswith(("/v1/takes/", "/v1/trash/")) and path.split("/")[-1] in of_take:
                return 200, of_take[path.split("/")[-1]](unquote(path.split("/")[3]), body)
            if path not in calls:
                raise Refused("not_found", f"there is no {path}")
            return 200, calls[path](body) or rig.status()
        except Refused as refused:
            return CODES[refused.kind], {"kind": refused.kind, "message": refused.message}

    def verify(self, name):
        for take in self.rig.takes:
            if take["name"] == name:
                take["health"] = "complete" if take["health"] == "unknown" else take["health"]
                take["seconds"], take["markers"] = take["seconds"] or 12.5, len(self.rig.body.labels)
                samples = int(take["seconds"] * self.rig.rate_hz) * take["markers"]
                return {"name": name, "health": take["health"], "seconds": take["seconds"], "samples": samples,
                        "tolerance_mm": 0.5, "max_error_mm": 0.499, "contradictions": [],
                        "problems": ["no footer"] if take["health"] == "cut off" else []}
        raise Refused("not_found", f"there is no take {name}")

    def stream(self, kind):
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Transfer-Encoding", "chunked")
        self.close_connection = True
        self.end_headers()

    def chunk(self, data):
        self.wfile.write(f"{len(data):x}\r\n".encode() + data + b"\r\n")
        self.wfile.flush()

    def live(self):
        rig, body = self.rig, self.rig.body
        table = {"labels": body.labels, "labelled": body.labelled, "up_axis": 3, "rate_hz": rig.rate_hz,
                 "bones": body.bones, "groups": rig.groups, "bodies": rig.body_names}
        self.stream("application/octet-stream")
        data = b"\x01" + json.dumps(table).encode()
        nothing = (math.nan,) * 3
        try:
            self.chunk(struct.pack("<I", len(data)) + data)
            due = started = time.time()
            while True:
                due = max(due + 1 / 30, time.time() - 0.1)
                time.sleep(max(0.0, due - time.time()))
                if rig.faults["cut_streams"] > started:
                    return
                if rig.armed_at is None or rig.faults["frozen"] or rig.faults["presence"] != "streaming":
                    continue
                now = time.time()
                t = now - rig.armed_at
                row = int(t * rig.rate_hz)
                values = [value for at in body.positions(t) for value in (at or nothing)]
                frame = struct.pack(f"<B3xQQQ{len(values)}f", 2, row, row * 1000, int(now * 1e6), *values)
                self.chunk(struct.pack("<I", len(frame)) + frame)
                if rig.body_names:
                    n = len(rig.body_names)
                    poses = struct.pack(f"<B3xQ{9 * n}f{n}Q", 5, row, *body_values(t), row, row // 2, 0)
                    self.chunk(struct.pack("<I", len(poses)) + poses)
                for column in rig.columns(t):
                    self.chunk(struct.pack("<I", len(column)) + column)
        except (BrokenPipeError, ConnectionResetError):
            pass

    def events(self):
        """Events as the service sends them: ids are `RUN-NUMBER`; an id of another run leads to `missed`."""
        rig, started = self.rig, time.time()
        run, _, number = self.headers.get("Last-Event-ID", "").rpartition("-")
        seen = int(number) if number and run == rig.session else 0
        self.stream("text/event-stream")
        try:
            if number and run != rig.session:
                self.chunk(b'event: missed\ndata: {"missed":null}\n\n')
            while rig.faults["cut_streams"] <= started:
                with rig.lock:
                    rig.lock.wait_for(lambda: len(rig.events) > seen, timeout=1)
                    new = rig.events[seen:]
                for event in new:
                    head = f"event: {event['kind']}\nid: {rig.session}-{event['number']}\n"
                    self.chunk(f"{head}data: {json.dumps(event)}\n\n".encode())
                if not new:
                    self.chunk(b": still here\n\n")
                seen += len(new)
        except (BrokenPipeError, ConnectionResetError):
            pass


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=8820, help="0: any free port")
    parser.add_argument("--markers", type=int, default=200)
    parser.add_argument("--rate", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sampled", action="store_true", help="with force plates and electrodes")
    parser.add_argument("--bodies", action="store_true", help="with rigid bodies")
    parser.add_argument("--token", help="require this token")
    parser.add_argument("--scenario", default="armed",
                        choices=["idle", "armed", "recording", "lossy", "absent", "silent", "armed-absent", "recording-absent", "failed"])
    args = parser.parse_args()
    Handler.rig, Handler.token = Rig(args.markers, args.rate, args.seed, args.scenario, args.sampled, args.bodies), args.token
    server = ThreadingHTTPServer(("127.0.0.1", args.port), Handler)
    server.daemon_threads = True
    print(f"http://127.0.0.1:{server.server_port}/", flush=True)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        sys.exit(0)


if __name__ == "__main__":
    main()
