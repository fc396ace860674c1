#!/usr/bin/env python3
"""Tests the dashboard in a real browser: against the mock, and against the daemon with a simulated device.

    tests/dashboard/check.py                               # the page alone
    tests/dashboard/check.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim
    tests/dashboard/check.py --only phone                  # checks whose name contains this

Needs requirements.txt, and Debian's chromium with chromium-driver. Screenshots go to the folder of `--pictures`. The
last line counts the checks that passed and failed.
"""

import argparse
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path

import checks_finished
import checks_page
import checks_player
import checks_sampled
import checks_service
import checks_subject
import checks_view
from browser import Browser


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    parser.add_argument("--chromedriver", default=shutil.which("chromedriver"))
    parser.add_argument("--firefox", default=shutil.which("firefox-esr") or shutil.which("firefox"), help="without it, the shared page is tested in chromium alone")
    parser.add_argument("--pictures", type=Path, help="folder for the screenshots; without it they are discarded")
    parser.add_argument("--mocapd", type=Path, help="the daemon; without it only the page is tested")
    parser.add_argument("--mocapd-sim", type=Path, help="the simulated device")
    parser.add_argument("--drawn-subject", type=Path, help="folder of the example drawn_subject of mocapd-testkit")
    parser.add_argument("--takes", type=Path, help="folder of recorded takes; without it no face is checked")
    parser.add_argument("--picture", type=Path, help="write the screenshot of the documentation to this file")
    parser.add_argument("--only", default="", help="run only the checks whose name contains this")
    args = parser.parse_args()
    if not args.chromium or not args.chromedriver:
        parser.error("chromium or chromedriver is missing: apt-get install chromium chromium-driver")
    if (args.mocapd is None) != (args.mocapd_sim is None):
        parser.error("--mocapd and --mocapd-sim go together")
    checks = [*checks_page.CHECKS, *checks_player.CHECKS, *checks_sampled.CHECKS, *checks_finished.CHECKS]
    if args.mocapd:
        checks += checks_finished.checks(args.mocapd.resolve(), args.mocapd_sim.resolve())
        checks += checks_sampled.checks(args.mocapd.resolve(), args.mocapd_sim.resolve())
        checks += checks_service.checks(args.mocapd.resolve(), args.mocapd_sim.resolve(), args.picture)
        checks += checks_view.checks(args.mocapd.resolve())
        if args.drawn_subject:
            checks += checks_subject.checks(args.mocapd.resolve(), args.mocapd_sim.resolve(),
                                            args.drawn_subject.resolve(), args.takes)
    passed, failed = 0, 0
    with tempfile.TemporaryDirectory(prefix="mocapd-dashboard-") as temporary:
        pictures, downloads = args.pictures or Path(temporary) / "pictures", Path(temporary) / "downloads"
        for folder in (pictures, downloads):
            folder.mkdir(parents=True, exist_ok=True)
        if args.mocapd and args.firefox:
            checks += checks_view.firefox_checks(args.mocapd.resolve(), args.firefox, pictures.resolve())
        browser = Browser(args.chromium, args.chromedriver, pictures.resolve(), downloads.resolve())
        browser.media(prefers_color_scheme="dark")
        try:
            for name, check in checks:
                if args.only not in name:
                    continue
                began = time.monotonic()
                # Drop the messages of the previous page, whose service was stopped.
                browser.open("about:blank")
                browser.errors()
                try:
                    check(browser, lambda text: print(f"    {text}", flush=True))
                    passed += 1
                    print(f"ok      {name} ({time.monotonic() - began:.1f} s)", flush=True)
                except Exception:  # A failed check must not hide the others.
                    failed += 1
                    traceback.print_exc()
                    browser.picture(f"failed-{failed}")
                    print(f"FAILED  {name}", flush=True)
        finally:
            browser.close()
    print(f"{passed} passed, {failed} failed")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
