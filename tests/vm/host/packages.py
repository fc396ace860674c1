"""Debian packages, downloaded and unpacked into a folder; nothing is installed, and root is not needed."""

import hashlib
import os
import platform
import shutil
import subprocess
import tarfile
from pathlib import Path

from . import Absent, Failed, kernel

# Not linux-image-cloud-amd64: it has no USB at all.
KERNEL = "linux-image-amd64"
EMULATOR = "qemu-system-x86"
# What the guest needs beside the kernel; libraries are found by what its programs ask for.
GUEST = ["busybox-static", "udev"]

# What is made in the cache folder, and nothing else there is ever removed.
FOLDERS = ("emulator", "guest", "kernel")


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
    """What the cache holds if these programs filled it, else what Debian has now. To fetch anew, delete the folder."""
    if platform.machine() != "x86_64":
        raise Absent(f"the emulated machine is an amd64 one, and this is {platform.machine()}")
    for tool in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise Absent(f"{tool} is not here: this needs a Debian machine")
    done = cache / "done"
    release, _, filled_by = done.read_text().partition(" ") if done.exists() else ("", "", "")
    if filled_by != programs_hash():
        for name in (KERNEL, EMULATOR, *GUEST):
            if not run("apt-cache", "madison", name):
                raise Absent(f"apt knows no package {name}: run `apt-get update`")
        empty(cache, done, FOLDERS)
        release = kernel_package().removeprefix("linux-image-")
        unpack(cache / "emulator", [EMULATOR] + missing(EMULATOR))
        unpack(cache / "guest", GUEST + missing(*GUEST))
        unpack(cache / "kernel", [f"linux-image-{release}"], kernel.is_needed)
        kernel.extract(cache / "kernel", release)
        done.write_text(f"{release} {programs_hash()}")
    return Unpacked(cache, release)


def programs_hash() -> str:
    """Of this folder's programs, which say what is fetched and what is made of it."""
    programs = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(program.read_bytes() for program in programs)).hexdigest()


def empty(cache: Path, done: Path, folders: tuple[str, ...]) -> None:
    """Removes what an earlier run made. `done` stands there from the beginning, to tell our folders from others'."""
    for folder in (cache / name for name in folders):
        if folder.exists():
            if not done.exists():
                raise Failed(f"{folder} was not made here: set MOCAPD_VM_CACHE to a folder for this alone")
            shutil.rmtree(folder)
    cache.mkdir(parents=True, exist_ok=True)
    done.write_text("")


def kernel_package() -> str:
    for line in run("apt-cache", "depends", KERNEL).splitlines():
        word, _, name = line.strip().partition(" ")
        if word == "Depends:" and name.startswith("linux-image-"):
            return name
    raise Failed(f"{KERNEL} depends on no kernel")


def missing(*names: str) -> list[str]:
    """What those need and this machine lacks."""
    said = run("apt-get", "-qq", "-s", "--no-install-recommends", "install", *names)
    return [line.split()[1] for line in said.splitlines() if line.startswith("Inst ")]


def unpack(folder: Path, names: list[str], wanted=lambda name: True) -> None:
    debs = folder / "debs"
    debs.mkdir(parents=True)
    run("apt-get", "-qq", "download", *sorted(set(names)), cwd=debs)
    for deb in sorted(debs.iterdir()):
        extract(deb, folder, wanted)
    shutil.rmtree(debs)


def extract(deb: Path, folder: Path, wanted) -> None:
    try:
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", deb], stdout=subprocess.PIPE) as data:
            with tarfile.open(fileobj=data.stdout, mode="r|") as files:
                for file in files:
                    if wanted(file.name) and (file.isfile() or file.issym() or file.islnk()):
                        files.extract(file, folder)
            # The padding too: dpkg-deb would take a closed pipe for a failure.
            while data.stdout.read(1 << 16):
                pass
    except tarfile.TarError as why:
        raise Failed(f"dpkg-deb cannot unpack {deb.name}: {why}") from why
    if data.returncode != 0:
        raise Failed(f"dpkg-deb cannot unpack {deb.name}: exit code {data.returncode}")


def run(*command: str, cwd=None) -> str:
    # In English, which is what is read here.
    environment = dict(os.environ, LC_ALL="C")
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = " ".join(done.stderr.split())[-300:]
        raise Failed(f"`{' '.join(command[:4])}...` failed; `apt-get update` may help: {said}")
    return done.stdout
