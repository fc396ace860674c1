#!/usr/bin/env python3
"""Latency of capture stops of one sender, alone and beside a hostile sender of delayed triggers.

A sender at 127.0.0.1 starts and stops a take every two seconds. The hostile one, at 127.0.0.2, sends one datagram per
second with a delay of 60 s, or the longest that is allowed. Measured once with the former in trigger.allow_from, once
with any sender allowed. Passes if every stop takes effect and the 99th percentile is at most three times the one alone.

    hostile_triggers.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim
"""

import argparse
import http.client
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

RATIO_MAX = 3.0
CYCLE_S = 2.0
# A stop without effect within this time counts as lost.
TIMEOUT_S = 15.0
POLL_S = 0.002


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--mocapd", type=Path, default=Path("target/release/mocapd"))
    arguments.add_argument("--mocapd-sim", type=Path, default=Path("target/release/mocapd-sim"))
    arguments.add_argument("--seconds", type=float, default=120, help="duration of each of the four measurements")
    options = arguments.parse_args()
    good = True
    for name, allow_from in (("known sender", ["127.0.0.1"]), ("any sender", [])):
        with tempfile.TemporaryDirectory(prefix="mocapd-triggers-") as folder:
            with Service(options, Path(folder), allow_from) as service:
                good &= compare(options, service, name)
    sys.exit(not good)


def compare(options, service, name):
    alone = measure(options, service, f"{name}, alone", hostile=False)
    beside = measure(options, service, f"{name}, beside a hostile sender", hostile=True)
    ratio = p99(beside) / p99(alone) if alone and beside else float("inf")
    good = ratio <= RATIO_MAX and None not in alone + beside
    print(f"{'good' if good else 'BAD '}  {name}: p99 is {ratio:.2f} times that alone (at most {RATIO_MAX})")
    return good


def p99(times):
    known = sorted(TIMEOUT_S if s is None else s for s in times)
    return known[max(0, -(-len(known) * 99 // 100) - 1)]


def measure(options, service, name, hostile):
    ending = threading.Event()
    disturbing = threading.Thread(target=disturb, args=(service, ending))
    if hostile:
        disturbing.start()
    times = []
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        began = time.monotonic()
        times.append(service.cycle())
        time.sleep(max(0.0, began + CYCLE_S - time.monotonic()))
    ending.set()
    if hostile:
        disturbing.join()
    acted = sum(s is not None for s in times)
    middle = sorted(TIMEOUT_S if s is None else s for s in times)[len(times) // 2]
    print(f"{name}: {acted} of {len(times)} stops effective, p50 {middle * 1e3:.1f} ms, p99 {p99(times) * 1e3:.1f} ms")
    return times


def disturb(service, ending):
    """Sends one datagram per second; none names a current take, since every allowed sender may stop one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.2", 0))
        packet = 10**9
        while not ending.wait(1.0):
            packet += 1
            element, delay_ms = (("CaptureStart", 60000), ("CaptureStop", 5000))[packet % 2]
            sender.sendto(datagram(element, "disturb", delay_ms, packet), service.trigger_at)


def datagram(element, name, delay_ms, packet):
    inside = f'<Name VALUE="{name}"/><Delay VALUE="{delay_ms}"/><PacketID VALUE="{packet}"/>'
    return f"<{element}>{inside}</{element}>".encode()


class Service:
    """A simulated device, and the service that receives triggers."""

    def __init__(self, options, folder, allow_from):
        self.options, self.folder, self.allow_from = options, folder, allow_from
        self.children, self.packet, self.client = [], 0, None
        self.http_at, self.trigger_at = free_address(socket.SOCK_STREAM), free_address(socket.SOCK_DGRAM)

    def __enter__(self):
        pty = self.folder / "rig"
        self.start(self.options.mocapd_sim, "serve", "--generate", "jump:1", "--seconds", "3", "--loop", f"--pty={pty}")
        wait(pty.exists, "the simulated device")
        config = self.folder / "mocapd.toml"
        config.write_text(
            f"[device]\nuri = 'serial:{pty}'\n[take]\ndirectory = '{self.folder / 'takes'}'\n"
            f"[http]\nsocket = ''\nlisten = '{self.http_at[0]}:{self.http_at[1]}'\n"
            f"[trigger]\nlisten = '{self.trigger_at[0]}:{self.trigger_at[1]}'\nallow_from = {json.dumps(self.allow_from)}\n"
        )
        self.start(self.options.mocapd, "run", "--config", config)
        wait(lambda: self.state() == "armed", "the service")
        return self

    def start(self, *command):
        log = open(self.folder / f"{Path(command[0]).name}.log", "wb")
        self.children.append(subprocess.Popen(list(map(str, command)), stdout=log, stderr=log))

    def status(self):
        try:
            if self.client is None:
                self.client = http.client.HTTPConnection(*self.http_at, timeout=10)
            self.client.request("GET", "/v1/status")
            return json.load(self.client.getresponse())
        except (OSError, http.client.HTTPException):
            self.client = None
            return {}

    def state(self):
        return self.status().get("state")

    def send(self, element, name):
        self.packet += 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind(("127.0.0.1", 0))
            sender.sendto(datagram(element, name, 0, self.packet), self.trigger_at)

    def wait_for(self, state):
        began = time.monotonic()
        while self.state() != state:
            if time.monotonic() - began > TIMEOUT_S:
                return None
            time.sleep(POLL_S)
        return time.monotonic() - began

    def cycle(self):
        """Starts and stops a take; returns the latency of the stop in seconds, or `None`."""
        name = f"take-{self.packet}"
        self.send("CaptureStart", name)
        if self.wait_for("recording") is None:
            return None
        time.sleep(0.5)
        self.send("CaptureStop", name)
        return self.wait_for("armed")

    def __exit__(self, *_):
        for child in reversed(self.children):
            child.terminate()
            try:
                child.wait(20)
            except subprocess.TimeoutExpired:
                child.kill()


def free_address(kind):
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()


def wait(ready, what):
    deadline = time.monotonic() + 20
    while not ready():
        if time.monotonic() > deadline:
            sys.exit(f"{what} did not start within 20 s")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
