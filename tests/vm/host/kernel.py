"""Debian's kernel: its image as the emulator starts it quickest, and which modules go in before which."""

import lzma
import re
import shutil
import subprocess
import zlib
from pathlib import Path

from . import Absent, Failed

# Two controllers: two devices at once.
MODULES = {"dummy_hcd": "num=2", "libcomposite": "", "usb_f_fs": "", "usb_f_acm": "", "cdc_acm": ""}

# For a scenario to load by itself.
EXTRA = ["usbserial"]


def is_needed(name: str) -> bool:
    parts = name.removeprefix("./")
    folders = ("boot/vmlinuz", "lib/modules/")
    return parts.startswith(folders) and ("/kernel/" not in parts or is_usb(parts))


def is_usb(name: str) -> bool:
    return any(f"/kernel/{folder}/" in name for folder in ("drivers/usb", "fs/configfs", "lib"))


def extract(folder: Path, release: str) -> None:
    """bzImage to ELF. The emulator starts that directly, and the guest need not decompress it: 4 to 8 s."""
    image = (folder / "boot" / f"vmlinuz-{release}").read_bytes()
    # Documentation/arch/x86/boot.rst: setup_sects, payload_offset, payload_length.
    setup = (image[0x1F1] + 1) * 512
    start = setup + int.from_bytes(image[0x248:0x24C], "little")
    payload = image[start : start + int.from_bytes(image[0x24C:0x250], "little")]
    elf = decompress(payload)
    # Its length stands behind the data.
    if not elf.startswith(b"\x7fELF") or len(elf) != int.from_bytes(payload[-4:], "little"):
        raise Failed(f"vmlinuz-{release} does not decompress to a kernel: {len(elf)} bytes")
    (folder / f"vmlinux-{release}").write_bytes(elf)


def decompress(payload: bytes) -> bytes:
    if payload.startswith(b"\xfd7zXZ\0"):
        return lzma.LZMADecompressor().decompress(payload)
    if payload.startswith(b"\x1f\x8b"):
        return zlib.decompressobj(wbits=31).decompress(payload)
    if payload.startswith(b"\x28\xb5\x2f\xfd"):
        if shutil.which("zstd") is None:
            raise Absent("zstd is not here, and the kernel is compressed with it")
        # It takes the length behind the data for an error; whether all is there is seen by that length.
        done = subprocess.run(["zstd", "-dcq"], input=payload, capture_output=True, check=False)
        return done.stdout
    raise Failed(f"a kernel image that begins with {payload[:6].hex()}")


class Module:
    """A kernel module with its parameters."""

    def __init__(self, name: str, file: Path, parameters: str):
        self.name = name
        self.parameters = parameters
        data = file.read_bytes()
        self.data = lzma.decompress(data) if file.suffix == ".xz" else data

    def needs(self) -> list[str]:
        """What its .modinfo says."""
        said = re.search(rb"\0depends=([^\0]*)\0", self.data)
        return [name for name in said[1].decode().split(",") if name] if said else []


def modules(folder: Path, names=tuple(MODULES)) -> list[Module]:
    """Each after those that it needs."""
    files = {}
    for file in folder.rglob("*.ko*"):
        files[file.name.split(".ko")[0].replace("-", "_")] = file
    ordered: dict[str, Module] = {}

    def add(name: str) -> None:
        name = name.replace("-", "_")
        if name in ordered:
            return
        module = Module(name, files[name], MODULES.get(name, ""))
        for needed in module.needs():
            add(needed)
        ordered[name] = module

    for name in names:
        add(name)
    return list(ordered.values())
