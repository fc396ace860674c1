"""The programs under test, as cargo builds them for this machine."""

import json
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def programs() -> list[Path]:
    """mocapd, mocapd-sim and the guest's program. An empty list is an error of cargo's, which it has told."""
    command = ["cargo", "build", "--release", "--locked", "--message-format=json-render-diagnostics"]
    what = ["-p", "mocapd", "-p", "mocapd-simulator", "--bins", "--example", "vm-guest"]
    done = subprocess.run(command + what, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    found = []
    for line in done.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable"):
            found.append(Path(message["executable"]))
    return found
