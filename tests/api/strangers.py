#!/usr/bin/env python3
"""Duration of `mocapd ctl status` on the Unix socket, alone and beside TCP clients that hold connections open.

100 calls alone and 100 beside these clients, alternately, several times. Passes if every call succeeds and the 99th
percentile beside them is at most three times the one alone.

    strangers.py --mocapd target/release/mocapd
"""

import argparse
import json
import os
import selectors
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

IDLE, DRIPPING = 64, 300
CALLS = 100
RATIO_MAX = 3.0
# Each slow connection sends one byte of a header at this interval, in seconds.
DRIP_S = 0.1
HEAD = b"GET /v1/status HTTP/1.1\r\nhost: localhost\r\nx-slow: " + b"a" * 4000


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--mocapd", type=Path, default=Path("target/release/mocapd"))
    arguments.add_argument("--strangers", nargs=2, help=argparse.SUPPRESS)
    arguments.add_argument("--rounds", type=int, default=5, help="number of rounds whose medians are compared")
    options = arguments.parse_args()
    if options.strangers:
        return Strangers((options.strangers[0], int(options.strangers[1]))).work()
    with tempfile.TemporaryDirectory(prefix="mocapd-strangers-") as folder:
        failed = run(options, Path(folder))
    sys.exit(failed)


def run(options, folder):
    at = free_port()
    socket_path = folder / "rig.sock"
    (folder / "token").write_text("correct-horse-battery-staple\n")
    (folder / "token").chmod(0o600)
    config = folder / "mocapd.toml"
    config.write_text(
        f"[arm]\nat_start = false\n[take]\ndirectory = '{folder / 'takes'}'\n"
        f"[http]\nsocket = '{socket_path}'\nlisten = '{at[0]}:{at[1]}'\ntoken_file = '{folder / 'token'}'\n"
    )
    with open(folder / "log", "wb") as log:
        service = subprocess.Popen([options.mocapd, "run", "--config", config], stdout=log, stderr=log)
    try:
        wait(lambda: call(options, socket_path)[1], "the service")
        alone, beside = [], []
        for n in range(1, options.rounds + 1):
            alone.append(calls(options, socket_path))
            strangers = start_strangers(at)
            beside.append(calls(options, socket_path))
            strangers = end(strangers)
            for name, (p50, p99, good) in (("alone", alone[-1]), ("strangers", beside[-1])):
                print(f"round {n}, {name}: {good} of {CALLS} answered, p50 {p50:.1f} ms, p99 {p99:.1f} ms")
            print(f"round {n}, strangers: {strangers['made']} connections, {strangers['refused']} answered 503")
    finally:
        service.terminate()
        service.wait(30)
    ratio = statistics.median(p99 for _, p99, _ in beside) / statistics.median(p99 for _, p99, _ in alone)
    good = all(good == CALLS for _, _, good in alone + beside) and ratio <= RATIO_MAX
    print(f"{'good' if good else 'BAD '}  median p99 is {ratio:.2f} times that alone (at most {RATIO_MAX})")
    return not good


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()


def wait(ready, what):
    deadline = time.monotonic() + 20
    while not ready():
        if time.monotonic() > deadline:
            sys.exit(f"{what} did not start within 20 s")
        time.sleep(0.1)


def call(options, socket_path):
    began = time.perf_counter()
    done = subprocess.run(
        [options.mocapd, "ctl", "status", "--json"],
        env={**os.environ, "MOCAPD_SOCKET": str(socket_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    return (time.perf_counter() - began) * 1e3, done.returncode == 0


def calls(options, socket_path):
    results = [call(options, socket_path) for _ in range(CALLS)]
    times = sorted(ms for ms, _ in results)
    return times[CALLS // 2], times[CALLS * 99 // 100 - 1], sum(good for _, good in results)


def start_strangers(at):
    """Starts the clients in a separate process, so that they do not slow down the measurement."""
    command = [sys.executable, __file__, "--strangers", at[0], str(at[1])]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    # Wait until all of them are connected.
    process.stdout.readline()
    return process


def end(process):
    counts, _ = process.communicate("\n", timeout=20)
    return json.loads(counts)


class Strangers:
    """Connections that are reopened as soon as they are closed."""

    def __init__(self, at):
        self.at, self.made, self.refused = at, 0, 0
        self.selector = selectors.DefaultSelector()

    def open(self, drips):
        stream = socket.socket()
        stream.setblocking(False)
        stream.connect_ex(self.at)
        self.made += 1
        self.selector.register(stream, selectors.EVENT_READ, drips)

    def work(self):
        os.nice(10)
        for n in range(IDLE + DRIPPING):
            self.open(drips=n >= IDLE)
        print("ready", flush=True)
        self.selector.register(sys.stdin, selectors.EVENT_READ)
        sent, next_drip = 0, time.monotonic()
        while True:
            for key, _ in self.selector.select(timeout=max(0.0, next_drip - time.monotonic())):
                if key.fileobj is sys.stdin:
                    print(json.dumps({"made": self.made, "refused": self.refused}))
                    return
                self.read(key)
            if time.monotonic() >= next_drip:
                next_drip += DRIP_S
                sent += 1
                for key in list(self.selector.get_map().values()):
                    if key.data:
                        self.drip(key.fileobj, HEAD[sent % len(HEAD) :][:1])

    def read(self, key):
        try:
            answer = key.fileobj.recv(4096)
        except OSError:
            answer = b""
        self.refused += answer.startswith(b"HTTP/1.1 503")
        if not answer or answer.startswith(b"HTTP/1.1 503"):
            self.selector.unregister(key.fileobj)
            key.fileobj.close()
            # Without a pause, 364 refused connections would measure the speed of Python.
            time.sleep(0.002)
            self.open(key.data)

    @staticmethod
    def drip(stream, byte):
        try:
            stream.send(byte)
        except OSError:
            pass


if __name__ == "__main__":
    main()
