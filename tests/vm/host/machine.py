"""The emulated machine: qemu without KVM, so that it runs wherever there is a processor."""

import os
import re
import subprocess
import tempfile
import threading
from pathlib import Path

from .packages import Unpacked

# Without the features that newer processors have: what the guest's C library would use of them is slow to emulate.
PROCESSOR = "qemu64"
PROCESSORS = 2
MEMORY_MIB = 1024
# Between the guest's last word and its end it only switches itself off: well under a second.
SWITCHING_OFF_S = 10.0
COMMAND_LINE = "console=ttyS0 quiet panic=-1 mitigations=off audit=0"


def boot(unpacked: Unpacked, initrd: Path, limit_s: float) -> int:
    """Runs the guest to its end. What it says goes to stdout; gives its exit code."""
    root = unpacked.emulator
    libraries = [root / "usr/lib/x86_64-linux-gnu", root / "lib/x86_64-linux-gnu"]
    environment = dict(
        os.environ,
        LD_LIBRARY_PATH=":".join(map(str, libraries)),
        QEMU_MODULE_DIR=str(libraries[0] / "qemu"),
    )
    with tempfile.NamedTemporaryFile() as code:
        command = [root / "usr/bin/qemu-system-x86_64"]
        for folder in ("usr/share/qemu", "usr/share/seabios", "usr/lib/ipxe/qemu"):
            command += ["-L", root / folder]
        command += ["-accel", "tcg,thread=multi", "-M", "q35", "-cpu", PROCESSOR, "-smp", str(PROCESSORS)]
        command += ["-m", str(MEMORY_MIB), "-nodefaults", "-display", "none", "-no-reboot"]
        command += ["-serial", "stdio", "-serial", f"file:{code.name}"]
        command += ["-kernel", unpacked.vmlinux, "-initrd", initrd, "-append", COMMAND_LINE]
        if not watch(command, environment, limit_s):
            print(f"the guest was stopped after {limit_s:.0f} s\n0 passed, 1 failed")
            return 1
        said = Path(code.name).read_text().strip()
    if not said.isdigit():
        print("the guest ended without an exit code: its kernel panicked, or its init failed\n0 passed, 1 failed")
        return 1
    return int(said)


def watch(command: list, environment: dict, limit_s: float) -> bool:
    """Prints what the guest says up to its last word. False when it took too long."""
    emulator = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    late = threading.Event()

    def stop() -> None:
        late.set()
        emulator.kill()

    timer = threading.Timer(limit_s, stop)
    timer.start()
    is_over = False
    try:
        for line in emulator.stdout:
            text = line.decode(errors="replace").rstrip()
            if not is_over:
                print(text, flush=True)
            # What the kernel says when it goes is of no interest.
            if not is_over and re.fullmatch(r"\d+ passed, \d+ failed", text):
                is_over = True
                timer.cancel()
                timer = threading.Timer(SWITCHING_OFF_S, emulator.kill)
                timer.start()
    finally:
        timer.cancel()
        emulator.kill()
        emulator.wait()
    return not late.is_set()
