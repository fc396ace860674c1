"""The guest's first and only file system: an initramfs with the programs, their libraries, modules and udev."""

import os
import stat
import subprocess
from pathlib import Path

from . import kernel
from .build import ROOT
from .packages import Unpacked

# Groups that udev's own rules name; dialout is the one that ours do.
GROUPS = {
    "root": 0, "tty": 5, "disk": 6, "lp": 7, "dialout": 20, "cdrom": 24, "tape": 26, "audio": 29,
    "video": 44, "plugdev": 46, "input": 101, "kvm": 102, "render": 103, "sgx": 104, "guest": 1000,
}


class Archive:
    """cpio in the form that the kernel unpacks: Documentation/driver-api/early-userspace/buffer-format.rst."""

    def __init__(self, path: Path):
        self.out = path.open("wb")
        self.inode = 0
        self.seen: set[str] = set()

    def entry(self, name: str, mode: int, data: bytes = b"", device=(0, 0)) -> None:
        if name in self.seen:
            return
        self.seen.add(name)
        self.inode += 1
        path = name.encode() + b"\0"
        numbers = (self.inode, mode, 0, 0, 1, 0, len(data), 0, 0, *device, len(path), 0)
        self.out.write(b"070701" + b"".join(b"%08x" % number for number in numbers) + path)
        self.pad()
        self.out.write(data)
        self.pad()

    def pad(self) -> None:
        self.out.write(bytes(-self.out.tell() % 4))

    def folder(self, name: str) -> None:
        for parent in list(reversed(Path(name).parents))[1:] + [Path(name)]:
            self.entry(str(parent), stat.S_IFDIR | 0o755)

    def file(self, name: str, data: bytes, mode: int = 0o644) -> None:
        self.folder(str(Path(name).parent))
        self.entry(name, stat.S_IFREG | mode, data)

    def program(self, name: str, path: Path) -> None:
        self.file(name, path.read_bytes(), 0o755)

    def link(self, name: str, target: str) -> None:
        self.folder(str(Path(name).parent))
        self.entry(name, stat.S_IFLNK | 0o777, target.encode())

    def close(self) -> None:
        self.entry("TRAILER!!!", 0)
        self.out.close()


def write(path: Path, unpacked: Unpacked, programs: list[Path], arguments: list[str]) -> None:
    archive = Archive(path)
    for name in ("dev", "proc", "sys", "run", "tmp", "bin", "lib/systemd", "etc/udev/rules.d"):
        archive.folder(name)
    archive.entry("dev/console", stat.S_IFCHR | 0o600, device=(5, 1))
    archive.program("bin/busybox", unpacked.guest / "bin" / "busybox")
    archive.program("init", Path(__file__).parents[1] / "guest" / "init")
    for program in programs:
        archive.program(f"bin/{program.name}", program)
    udevadm = unpacked.guest / "bin" / "udevadm"
    archive.program("bin/udevadm", udevadm)
    archive.link("lib/systemd/systemd-udevd", "/bin/udevadm")
    for rules in sorted((unpacked.guest / "lib/udev/rules.d").iterdir()):
        archive.file(f"lib/udev/rules.d/{rules.name}", rules.read_bytes())
    archive.file("rules/60-mocapd.rules", (ROOT / "systemd/60-mocapd.rules").read_bytes())
    libraries(archive, unpacked, programs + [udevadm])
    modules(archive, unpacked)
    groups = "".join(f"{name}:x:{number}:\n" for name, number in GROUPS.items())
    archive.file("etc/group", groups.encode())
    archive.file("etc/passwd", b"root:x:0:0::/:/bin/sh\nguest:x:1000:1000::/tmp:/bin/sh\n")
    archive.file("arguments", "\n".join(arguments).encode())
    archive.close()


def write_system(path: Path, root: Path, unpacked: Unpacked, files: dict[str, Path], arguments: list[str]) -> None:
    """The same for a guest that boots systemd: its whole root, and `files` in it by their names there."""
    archive = Archive(path)
    archive.entry("dev", stat.S_IFDIR | 0o755)
    archive.entry("dev/console", stat.S_IFCHR | 0o600, device=(5, 1))
    archive.program("bin/busybox", unpacked.guest / "bin" / "busybox")
    archive.program("init", Path(__file__).parents[1] / "guest" / "init-systemd")
    for name, file in files.items():
        archive.file(f"new/{name}", file.read_bytes(), 0o755)
    archive.file("new/arguments", "\n".join(arguments).encode())
    archive.file("new/kind", b"systemd")
    modules(archive, unpacked, "new/")
    for place, folders, names in os.walk(root):
        inside = Path("new") / Path(place).relative_to(root)
        archive.folder(str(inside))
        for name in folders + names:
            file = Path(place) / name
            mode = file.lstat().st_mode
            if stat.S_ISLNK(mode):
                archive.link(str(inside / name), os.readlink(file))
            elif stat.S_ISREG(mode):
                archive.file(str(inside / name), file.read_bytes(), stat.S_IMODE(mode))
    archive.close()


def libraries(archive: Archive, unpacked: Unpacked, programs: list[Path]) -> None:
    """What the programs ask for, from this machine or from the packages."""
    folders = [unpacked.guest / f"{part}lib/x86_64-linux-gnu{sub}" for part in ("", "usr/") for sub in ("", "/systemd")]
    environment = dict(os.environ, LD_LIBRARY_PATH=":".join(map(str, folders)))
    for program in programs:
        said = subprocess.run(["ldd", program], env=environment, capture_output=True, text=True, check=True)
        for line in said.stdout.splitlines():
            words = line.split()
            if "not" in words:
                raise FileNotFoundError(f"{program.name} needs {words[0]}, which is nowhere")
            name, path = words[0], words[2] if "=>" in words else words[0]
            if path.startswith("/"):
                # The loader's own path stands in the programs; the others it looks for in Debian's folder.
                place = name if name.startswith("/") else f"/lib/x86_64-linux-gnu/{name}"
                archive.program(place.lstrip("/"), Path(path).resolve())


def modules(archive: Archive, unpacked: Unpacked, under: str = "") -> None:
    for number, module in enumerate(kernel.modules(unpacked.modules)):
        name = f"{under}modules/{number:02}-{module.name}"
        archive.file(f"{name}.ko", module.data)
        archive.file(f"{name}.parameters", module.parameters.encode())
    for module in kernel.modules(unpacked.modules, kernel.EXTRA):
        archive.file(f"{under}modules/extra/{module.name}.ko", module.data)
