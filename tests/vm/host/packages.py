"""Debian packages, downloaded and unpacked into a folder; nothing is installed, and root is not needed."""

import platform
import shutil
import subprocess
import tarfile
from pathlib import Path

from . import kernel

# Not linux-image-cloud-amd64: it has no USB at all.
KERNEL = "linux-image-amd64"
EMULATOR = "qemu-system-x86"
# What the guest needs beside the kernel; libraries are found by what its programs ask for.
GUEST = ["busybox-static", "udev"]


class Absent(Exception):
    """This machine cannot give what is needed; the text says what."""


class Unpacked:
    """Where everything lies."""

    def __init__(self, cache: Path, release: str):
        self.emulator = cache / "emulator"
        self.guest = cache / "guest"
        self.kernel = cache / "kernel"
        self.release = release
        self.vmlinux = self.kernel / f"vmlinux-{release}"
        self.modules = self.kernel / "lib" / "modules" / release


def fetch(cache: Path) -> Unpacked:
    """What the cache holds, or what Debian has now. To fetch anew, delete the folder."""
    if platform.machine() != "x86_64":
        raise Absent(f"the emulated machine is an amd64 one, and this is {platform.machine()}")
    for tool in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise Absent(f"{tool} is not here: this needs a Debian machine")
    done = cache / "done"
    if not done.exists():
        shutil.rmtree(cache, ignore_errors=True)
        cache.mkdir(parents=True)
        release = kernel_package().removeprefix("linux-image-")
        unpack(cache / "emulator", [EMULATOR] + missing(EMULATOR))
        unpack(cache / "guest", GUEST + missing(*GUEST))
        unpack(cache / "kernel", [f"linux-image-{release}"], kernel.is_needed)
        kernel.extract(cache / "kernel", release)
        done.write_text(release)
    return Unpacked(cache, done.read_text())


def kernel_package() -> str:
    for line in run("apt-cache", "depends", KERNEL).splitlines():
        word, _, name = line.strip().partition(" ")
        if word == "Depends:" and name.startswith("linux-image-"):
            return name
    raise Absent(f"apt knows no package {KERNEL}: run `apt-get update`")


def missing(*names: str) -> list[str]:
    """What those need and this machine lacks."""
    said = run("apt-get", "-qq", "-s", "--no-install-recommends", "install", *names)
    return [line.split()[1] for line in said.splitlines() if line.startswith("Inst ")]


def unpack(folder: Path, names: list[str], wanted=lambda name: True) -> None:
    debs = folder / "debs"
    debs.mkdir(parents=True)
    run("apt-get", "-qq", "download", *sorted(set(names)), cwd=debs)
    for deb in sorted(debs.iterdir()):
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", deb], stdout=subprocess.PIPE) as data:
            with tarfile.open(fileobj=data.stdout, mode="r|") as files:
                for file in files:
                    if wanted(file.name) and (file.isfile() or file.issym() or file.islnk()):
                        files.extract(file, folder)
    shutil.rmtree(debs)


def run(*command: str, cwd=None) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = " ".join(done.stderr.split())[-300:]
        raise Absent(f"`{' '.join(command[:4])}...` failed: {said}")
    return done.stdout
