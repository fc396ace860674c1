"""The programs under test, as cargo builds them for this machine."""

import json
import os
import shutil
import subprocess
from pathlib import Path

from . import Absent

ROOT = Path(__file__).resolve().parents[3]


# With the features of the package (systemd/deb/build), so that every build takes what the one before it has made.
FEATURES = ",".join(f"mocapd/{name}" for name in os.environ.get("FEATURES", "full").split(",") if name)
PROGRAMS = ("-p", "mocapd", "-p", "mocapd-simulator", "-p", "mocapd-vm-guest", "--features", FEATURES, "--bins")


def programs() -> list[Path]:
    """mocapd, mocapd-sim and the guest's program. An empty list is an error of cargo's, which it has told."""
    return built("--release", *PROGRAMS)


def built(*what: str) -> list[Path]:
    command = ["cargo", "build", "--locked", "--message-format=json-render-diagnostics"]
    done = subprocess.run([*command, *what], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    found = []
    for line in done.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable"):
            found.append(Path(message["executable"]))
    return found


def hanging(folder: Path) -> Path:
    """Builds mocapd with the hooks that make it hang, and copies it to `folder`: the next build overwrites it in target/.

    It is built as tests are, which compiles three crates only. MOCAPD_HANGING names a program that was built before.
    """
    if os.environ.get("MOCAPD_HANGING"):
        return Path(os.environ["MOCAPD_HANGING"])
    program = next(path for path in built("-p", "mocapd", "--bins", "--features", "fault-hooks") if path.name == "mocapd")
    return Path(shutil.copy2(program, folder / "mocapd-hanging"))


def guest() -> Path:
    return next(path for path in programs() if path.name == "vm-guest")


def package(folder: Path) -> Path:
    """The Debian package."""
    if shutil.which("cargo-deb") is None:
        raise Absent("cargo-deb is not here: cargo install --locked cargo-deb")
    # Compressed less: 4 s of processor time in place of 19, where cargo-deb was built without optimisation.
    done = subprocess.run([ROOT / "systemd/deb/build", folder, "--fast"], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return Path(done.stdout.splitlines()[-1])
