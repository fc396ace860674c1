#!/usr/bin/env python3
"""Tests takes in object storage against moto's S3 server: every command, what is created and never replaced, errors, and
the requests and bytes of windows.

    check.py --mocapd target/debug/mocapd --mocapd-sim target/debug/mocapd-sim --windows target/debug/examples/windows

With --mocapd-sim, a service records a simulated device and uploads its takes while the store hangs, fails and comes back.
With --markers 200 --rate 1000 --seconds 20 each take is one of a large rig; docs/archive.md has the result.
"""

import argparse
import csv
import json
import math
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import uploads
from s3 import ANYBODY, BUCKET, Store

results = []
began = time.monotonic()


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--mocapd", required=True, type=Path)
    arguments.add_argument("--windows", required=True, type=Path, help="the example `windows` of the crate mocapd-store")
    arguments.add_argument("--mocapd-sim", type=Path)
    arguments.add_argument("--only-uploads", action="store_true")
    arguments.add_argument("--markers", type=int, default=15, help="of the simulated device")
    arguments.add_argument("--rate", type=int, default=240, help="frames a second of the simulated device")
    arguments.add_argument("--seconds", type=float, default=1, help="of each take that is recorded")
    options = arguments.parse_args()
    # A rig waits for a store most of the time: the commands have another one meanwhile.
    with ThreadPoolExecutor() as pool:
        checks = [pool.submit(with_store, check_uploads, options)] if options.mocapd_sim else []
        if not options.only_uploads:
            checks += [pool.submit(with_store, check, options) for check in (check_commands, check_windows)]
        for check in checks:
            check.result()
    finish()


def with_store(check, options):
    with tempfile.TemporaryDirectory(prefix="mocapd-store-") as folder, Store(folder) as store:
        check(options, Path(folder), store)


def check_uploads(options, folder, store):
    uploads.check(report, options, folder / "rig", store)


def check_commands(options, folder, store):
    check = Check(options, folder, store)
    check.created_once()
    check.every_command()
    check.folders()
    check.parts()
    check.refusals()


def check_windows(options, folder, store):
    Check(options, folder, store).windows()


def finish():
    # CI adds up the last lines of all checks.
    print(f"in {time.monotonic() - began:.0f} s")
    print(f"{results.count(True)} passed, {results.count(False)} failed")
    sys.exit(False in results)


def report(check, passed, details=""):
    print(f"{time.monotonic() - began:5.1f} s  {'good' if passed else 'BAD '}  {check}")
    if not passed:
        print(details)
    results.append(bool(passed))


def motion(path, seconds, markers=12, rate=120, noise=0.0):
    """A person who stands, walks and stands again, as CSV."""
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time"] + [f"m{i}_{axis}" for i in range(markers) for axis in "xyz"])
        for row in range(int(seconds * rate)):
            t = row / rate
            moving = max(0.0, math.sin(math.pi * t / max(seconds, 1)))
            values = []
            for i in range(markers):
                jitter = noise * ((row * 7919 + i * 104729) % 1013 - 506) / 506
                values += [
                    f"{800 * moving * t + 90 * moving * math.sin(5 * t + i) + jitter:.4f}",
                    f"{70 * i + 40 * moving * math.cos(7 * t + i) - jitter:.4f}",
                    f"{900 + 25 * i + 30 * moving * math.sin(10 * t + i) + jitter:.4f}",
                ]
            rows.writerow([f"{t:.6f}"] + values)


class Check:
    def __init__(self, options, folder, store):
        self.options, self.folder, self.store = options, folder, store
        self.csv, self.take = folder / "walk.csv", folder / "walk.take"
        motion(self.csv, 20)
        self.run("import", self.csv, "-o", self.take)

    def run(self, *arguments, environment=None):
        return subprocess.run(
            [str(self.options.mocapd), *map(str, arguments)],
            env=self.store.environment() if environment is None else environment,
            cwd=self.folder, capture_output=True, text=True, timeout=120,
        )

    def url(self, name):
        return f"s3://{BUCKET}/{name}"

    def created_once(self):
        ran = self.run("import", self.csv, "-o", self.url("a/walk.take"))
        same = self.store.content("a/walk.take") == self.take.read_bytes()
        report("an import to a bucket is the take of an import to a file", ran.returncode == 0 and same, ran.stderr)
        other = self.run("import", self.csv, "-o", self.url("a/walk.take"), "--tolerance", "5mm")
        kept = self.store.content("a/walk.take") == self.take.read_bytes()
        refused = other.returncode == 1 and "exists already" in other.stderr
        report("an object is never replaced", refused and kept, other.stderr)

    def every_command(self):
        url = self.url("a/walk.take")
        local = json.loads(self.run("info", self.take, "--json").stdout)
        before = len(self.store.requests)
        found = json.loads(self.run("info", url, "--json").stdout)
        asked = len(self.store.requests) - before
        stored = found.pop("store", {})
        found["take"] = local["take"] = ""
        report("info of a URL is that of the file", found == local, f"{found}\n{local}")
        counted = stored.get("requests") == asked and stored.get("received_bytes") == self.take.stat().st_size
        report(f"info reads each byte once, in {asked} requests, and counts them", counted, f"{stored} {asked}")
        report("info states the requests of a window", stored.get("window_requests") in (1, 2, 3), stored)
        for name, arguments in {
            "verify": ["verify", url, "--against", self.csv],
            "verify against a URL": ["verify", self.take, "--against", url],
            "diff": ["diff", url, self.take],
            "diff with a URL second": ["diff", self.take, url],
            "gaps": ["gaps", url],
            "cut": ["cut", url, "--from", "2s", "--to", "4s", "-o", self.url("b/cut.take")],
            "concat": ["concat", url, self.url("b/cut.take"), "-o", self.url("b/joined.take")],
            "recover": ["recover", url, "-o", self.url("b/recovered.take")],
            "repack": ["repack", url, "--copy", "-o", self.url("b/repacked.take")],
            "plot": ["plot", "trajectory", url, "-o", self.url("b/walk.svg")],
            "export": ["export", url, "-o", self.url("b/walk.c3d")],
            "export to a file": ["export", url, "-o", self.folder / "x.trc"],
            "import from a URL": ["import", self.url("b/walk.c3d"), "-o", self.url("b/again.take")],
            "file URLs": ["info", f"file://{self.take}"],
        }.items():
            ran = self.run(*arguments)
            report(name, ran.returncode == 0, f"{ran.returncode}: {ran.stdout}{ran.stderr}")
        self.run("export", self.take, "-o", self.folder / "local.c3d")
        same = self.store.content("b/walk.c3d") == (self.folder / "local.c3d").read_bytes()
        report("an export to a bucket has the bytes of one to a file", same)

    def folders(self):
        sources = self.folder / "sources"
        (sources / "day 1").mkdir(parents=True)
        for name in ("one.csv", "two.csv", "day 1/three.csv"):
            (sources / name).write_bytes(self.csv.read_bytes())
        first = self.run("import", sources, "--recursive", "-o", self.url("many/"))
        names = [name for name in self.store.objects() if name.startswith("many/")]
        expected = ["many/day 1/three.take", "many/one.take", "many/two.take"]
        report("a folder becomes a folder of a bucket", first.returncode == 0 and names == expected, f"{names}{first.stderr}")
        again = self.run("import", sources, "--recursive", "-o", self.url("many/"))
        unchanged = again.returncode == 0 and again.stdout.count("unchanged, imported before") == 3
        report("a second import changes nothing", unchanged, again.stdout + again.stderr)
        listed = self.run("info", self.url("many/"), "--json").stdout.splitlines()
        report("a folder of a bucket is listed", len(listed) == 2, listed)
        listed = self.run("verify", self.url("many/"), "--recursive", "--json").stdout.splitlines()
        report("and its subfolders", len(listed) == 3, listed)

    def parts(self):
        large, take = self.folder / "large.csv", self.folder / "large.take"
        motion(large, 40, markers=60, rate=120, noise=0.3)
        self.run("import", large, "-o", take)
        ran = self.run("export", take, "-o", self.url("parts/large.csv"))
        content = self.store.content("parts/large.csv") or b""
        self.run("export", take, "-o", self.folder / "exported.csv")
        same = content == (self.folder / "exported.csv").read_bytes()
        names = [name for name in self.store.objects() if name.startswith("parts/")]
        posted = sum(command == "POST" for command, path, _ in self.store.requests if "/parts/" in path)
        whole = ran.returncode == 0 and len(content) > 8 << 20 and same and names == ["parts/large.csv"]
        report(f"a file of {len(content)} bytes is sent in parts, and nothing else is left", whole and posted >= 2,
               f"{ran.stderr}{len(content)} {names} {posted}")

    def windows(self):
        """The table of requests and bytes of a second of each kind of take."""
        plain = self.folder / "long.csv"
        motion(plain, 90, markers=60, rate=120, noise=0.3)
        urls = []
        for name, options in {
            "dense 1 mm": ["--tolerance", "1mm"], "fast 1 mm": ["--tolerance", "1mm", "--resampler", "fast"],
            "lossless": ["--lossless"], "keys of 2 s": ["--tolerance", "1mm", "--keys", "2s"],
        }.items():
            urls.append(self.url(f"windows/{name}.take"))
            ran = self.run("import", plain, "-o", urls[-1], *options)
            assert ran.returncode == 0, ran.stderr
        self.run("demo", "--seconds", "5", "--out", self.folder / "demo")
        recorded = next((self.folder / "demo").glob("*.take"))
        urls.append(f"file://{recorded}")
        before = len(self.store.requests)
        ran = subprocess.run([str(self.options.windows), *urls], env=self.store.environment(),
                             capture_output=True, text=True, timeout=120)
        sent = len(self.store.requests) - before
        rows = [json.loads(line) for line in ran.stdout.splitlines()]
        print(f"      {'take':<24} {'bytes':>9} {'requests':>8} {'2nd range':>9} {'bytes a window':>14} {'of needed':>9}")
        for row in rows:
            print(f"      {row['url'].rsplit('/', 1)[1]:<24} {row['take_bytes']:>9} {row['requests_max']:>8} "
                  f"{row['second_ranges']:>6}/{row['windows']} {row['window_bytes'] // row['windows']:>14} "
                  f"{row['ratio_max']:>9.2f}")
        report("takes are opened from their end", len(rows) == len(urls) and all(row["from_end"] for row in rows), ran.stderr)
        report("a window of a second needs at most 3 requests", all(row["requests_max"] <= 3 for row in rows), rows)
        report("and at most twice the bytes of its stretches", all(row["ratio_max"] <= 2 for row in rows), rows)
        ranges = [found for command, _, found in self.store.requests[before:] if command == "GET" and found]
        report("every request is for a range", sent == len(ranges) and "bytes=-65536" in ranges, self.store.requests[before:][:5])

    def refusals(self):
        url = self.url("a/walk.take")
        stopped = {name: value for name, value in self.store.environment().items() if name != "AWS_ENDPOINT_URL"}
        for what, arguments, words, code in [
            ("a missing object", ["info", self.url("nothing.take")], "does not exist", 1),
            ("a missing bucket", ["info", "s3://nowhere/walk.take"], "bucket", 1),
            ("a missing bucket to write to", ["import", self.csv, "-o", "s3://nowhere/walk.take"], "bucket", 1),
            ("an unknown scheme", ["info", "ftp://host/walk.take"], "expected s3://", 2),
            ("a recording to a URL", ["record", "--device", "serial:/dev/null", "-o", self.url("x.take")], "[archive]", 2),
            ("a raw log to a URL", ["record", "--device", "serial:/dev/null", "-o", "x.take", "--raw", self.url("x.log")],
             "[archive]", 2),
            ("writing to a web server", ["import", self.csv, "-o", "https://host/walk.take"], "read only", 2),
            ("a BIDS dataset in a bucket", ["export", url, "--format", "bids", "-o", self.url("bids")], "folder of this machine", 2),
        ]:
            ran = self.run(*arguments)
            report(f"{what} is refused", ran.returncode == code and words in ran.stderr, f"{ran.returncode}: {ran.stderr}")
        ran = self.run("info", "https://me:secret@host/walk.take")
        refused = ran.returncode == 2 and "secret" not in ran.stderr and "***@host" in ran.stderr
        report("a password in a URL is refused and not shown", refused, f"{ran.returncode}: {ran.stderr}")
        self.store.mode = "replaces"
        ran = self.run("import", self.csv, "-o", self.url("c/walk.take"))
        self.store.mode = "works"
        left = [name for name in self.store.objects() if name.startswith("c/")]
        refused = ran.returncode == 1 and "ignores If-None-Match" in ran.stderr
        report("a store that ignores conditions gets no object", refused and not left, f"{ran.returncode}: {ran.stderr}{left}")
        nobody = {name: value for name, value in stopped.items() if not name.startswith("AWS_")}
        nobody |= {"AWS_METADATA_ENDPOINT": "http://127.0.0.1:9/", "AWS_ENDPOINT_URL": self.store.url}
        ran = self.run("info", url, environment=nobody)
        report("without credentials the message names where they go", "AWS_ACCESS_KEY_ID" in ran.stderr, ran.stderr)
        for mode, words in (("fails", "unavailable"), ("hangs", "did not answer in time")):
            self.store.mode = mode
            ran = self.run("info", url, environment={**self.store.environment(), "AWS_TIMEOUT": "1 second"})
            self.store.mode = "works"
            report(f"a store that {mode} is an error", ran.returncode == 1 and words in ran.stderr, ran.stderr)
        self.store.ask("PUT", f"/{BUCKET}/a/walk.take?acl", headers={**ANYBODY, "x-amz-acl": "public-read"})
        web = self.run("info", f"{self.store.url}/{BUCKET}/a/walk.take")
        report("a web server is read by ranges", web.returncode == 0, web.stderr)


if __name__ == "__main__":
    main()
