"""An S3 store for tests: moto's server, behind a proxy that counts requests, and hangs or fails when told to."""

import http.client
import http.server
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

BUCKET = "lab"
# moto checks who asks, but no signature.
ANYBODY = {"Authorization": "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request"}


class Store:
    """The store. `mode` is "works", "hangs" (requests are accepted and not answered), "fails" (with status 503) or
    "replaces" (conditions of creations are ignored)."""

    def __init__(self, folder):
        self.folder, self.mode, self.requests = Path(folder), "works", []

    def __enter__(self):
        self.moto_port = free_port()
        log = open(self.folder / "moto.log", "wb")
        command = [Path(sys.executable).with_name("moto_server"), "-H", "127.0.0.1", "-p", str(self.moto_port)]
        self.moto = subprocess.Popen(list(map(str, command)), stdout=log, stderr=log)
        store = self

        class Proxy(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def forward(self):
                store.forward(self)

            do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = forward

            def log_message(self, *_):
                pass

        self.proxy = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy)
        self.proxy.daemon_threads = True
        threading.Thread(target=self.proxy.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.proxy.server_address[1]}"
        deadline = time.monotonic() + 30
        while True:
            try:
                self.ask("PUT", f"/{BUCKET}")
                return self
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)

    def __exit__(self, *_):
        self.mode = "works"
        self.proxy.shutdown()
        self.moto.terminate()
        self.moto.wait(20)

    def forward(self, request):
        """Passes a request on to moto, or not."""
        body = request.rfile.read(int(request.headers.get("Content-Length", 0)))
        self.requests.append((request.command, request.path, request.headers.get("Range")))
        if self.mode == "hangs":
            while self.mode == "hangs":
                time.sleep(0.05)
            request.close_connection = True
            return
        if self.mode == "fails":
            request.send_response(503)
            request.send_header("Content-Length", "0")
            request.end_headers()
            return
        passed = dict(request.headers)
        if self.mode == "replaces":
            passed = {name: value for name, value in passed.items() if name.lower() != "if-none-match"}
        status, headers, answer = self.ask(request.command, request.path, body, passed)
        request.send_response(status)
        for name, value in headers:
            if name.lower() not in ("transfer-encoding", "connection", "content-length", "server", "date"):
                request.send_header(name, value)
        length = dict((name.lower(), value) for name, value in headers).get("content-length")
        request.send_header("Content-Length", length if request.command == "HEAD" and length else str(len(answer)))
        request.end_headers()
        if request.command != "HEAD":
            request.wfile.write(answer)

    def ask(self, method, path, body=b"", headers=None):
        """A request to moto itself, which is not counted."""
        connection = http.client.HTTPConnection("127.0.0.1", self.moto_port, timeout=60)
        connection.request(method, path, body, ANYBODY if headers is None else headers)
        answer = connection.getresponse()
        found = answer.status, answer.getheaders(), answer.read()
        connection.close()
        return found

    def objects(self):
        """The names of all objects."""
        import xml.etree.ElementTree as xml

        _, _, listing = self.ask("GET", f"/{BUCKET}?list-type=2")
        return sorted(key.text for key in xml.fromstring(listing).iter() if key.tag.endswith("}Key"))

    def content(self, key):
        status, _, content = self.ask("GET", f"/{BUCKET}/{key}")
        return content if status == 200 else None

    def environment(self):
        """The variables with which a program finds the store."""
        return {
            **{name: value for name, value in os.environ.items() if not name.startswith("AWS_")},
            "AWS_ENDPOINT_URL": self.url,
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }


def free_port():
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]
