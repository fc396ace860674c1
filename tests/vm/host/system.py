"""Debian's own base system with systemd, for a guest that boots it: packages unpacked, and what their scripts would do."""

import os
import shutil
import subprocess
from pathlib import Path

from . import Failed
from .packages import empty, programs_hash, run

# With what they depend on. dash is /bin/sh, and nothing says that it is needed.
PACKAGES = [
    "base-files", "base-passwd", "bash", "coreutils", "dash", "dbus", "diffutils", "dpkg", "findutils", "grep",
    "gzip", "kmod", "libc-bin", "libgcc-s1", "libnss-systemd", "login", "mount", "passwd", "procps", "sed",
    "systemd", "systemd-sysv", "tar", "udev", "util-linux",
]

# Nobody reads them there, and everything has to fit into memory twice while it boots.
LEFT_OUT = [
    "./usr/share/doc", "./usr/share/man", "./usr/share/locale", "./usr/share/info", "./usr/share/lintian",
    "./usr/share/perl*", "./usr/share/i18n", "./usr/share/zoneinfo", "./usr/share/bash-completion", "./usr/share/zsh",
    "./usr/lib/x86_64-linux-gnu/perl*", "./usr/lib/x86_64-linux-gnu/gconv", "./usr/lib/systemd/boot",
    "./usr/lib/udev/hwdb.d", "./usr/lib/locale", "./usr/bin/perl*", "./usr/share/unicode", "./usr/lib/python*",
]

# Units that find no hardware, no network and nothing to do in this machine, and would take seconds.
MASKED = """
apt-daily.timer apt-daily-upgrade.timer console-getty.service cryptsetup.target dev-hugepages.mount dev-mqueue.mount
dpkg-db-backup.timer e2scrub_all.timer e2scrub_reap.service fstrim.timer getty.target integritysetup.target
ldconfig.service modprobe@dm_mod.service modprobe@drm.service modprobe@efi_pstore.service modprobe@fuse.service
modprobe@loop.service modprobe@configfs.service proc-sys-fs-binfmt_misc.automount remote-fs.target swap.target
sys-fs-fuse-connections.mount sys-kernel-debug.mount sys-kernel-tracing.mount systemd-ask-password-console.path
systemd-ask-password-wall.path systemd-binfmt.service systemd-firstboot.service systemd-hwdb-update.service
systemd-journal-catalog-update.service systemd-journal-flush.service systemd-machine-id-commit.service
systemd-modules-load.service systemd-networkd.service systemd-pstore.service systemd-random-seed.service
systemd-remount-fs.service systemd-sysctl.service systemd-sysusers.service systemd-timesyncd.service
systemd-tmpfiles-clean.timer systemd-update-done.service systemd-update-utmp-runlevel.service
systemd-update-utmp.service veritysetup.target
""".split()

TARGET = """[Unit]
Description=The scenarios
Requires=basic.target
Wants=scenarios.service dbus.socket
After=basic.target
AllowIsolate=yes
"""

SERVICE = """[Unit]
After=basic.target dbus.socket

[Service]
StandardOutput=tty
StandardError=tty
TTYPath=/dev/ttyS0
Environment=PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin RUST_BACKTRACE=1
WorkingDirectory=/tmp
ExecStart=/bin/sh -c 'vm-guest; echo $? >/dev/ttyS1; systemctl poweroff -ff'
"""


def fetch(cache: Path) -> Path:
    """The folder that is the guest's root; filled once, and anew when these programs change."""
    root, done = cache / "system", cache / "system-done"
    if not done.exists() or done.read_text() != programs_hash():
        empty(cache, done, ("system",))
        said = run("apt-get", "-qq", "-o", "Dir::State::status=/dev/null", "-s", "--no-install-recommends", "install",
                   *PACKAGES)
        names = [line.split()[1] for line in said.splitlines() if line.startswith("Inst ")]
        unpack(root, names)
        set_up(root)
        done.write_text(programs_hash())
    return root


def unpack(root: Path, names: list[str]) -> None:
    for name in ("bin", "sbin", "lib", "lib64"):
        (root / "usr" / name).mkdir(parents=True)
        (root / name).symlink_to(f"usr/{name}")
    debs = root.parent / "system-debs"
    shutil.rmtree(debs, ignore_errors=True)
    debs.mkdir()
    run("apt-get", "-qq", "download", *names, cwd=debs)
    known = root / "var/lib/dpkg"
    (known / "info").mkdir(parents=True)
    (known / "updates").mkdir()
    (known / "available").touch()
    status = ""
    for deb in sorted(debs.iterdir()):
        left_out = [f"--exclude={name}" for name in LEFT_OUT]
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", deb], stdout=subprocess.PIPE) as files:
            # The links of the merged /usr stay.
            done = subprocess.run(["tar", "-x", "-C", root, "--keep-directory-symlink", "--no-same-owner", *left_out],
                                  stdin=files.stdout, check=False)
        if done.returncode != 0 or files.returncode != 0:
            raise Failed(f"cannot unpack {deb.name}")
        # For dpkg there they are installed, so that what a package depends on is looked for in earnest.
        package, _, rest = run("dpkg-deb", "-f", str(deb)).partition("\n")
        status += f"{package}\nStatus: install ok installed\n{rest}\n"
        name = package.removeprefix("Package: ")
        architecture = ":amd64" if "Multi-Arch: same" in rest else ""
        (known / "info" / f"{name}{architecture}.list").touch()
    (known / "status").write_text(status)
    shutil.rmtree(debs)


def set_up(root: Path) -> None:
    """What the packages' scripts would have done, as far as it is needed."""
    etc = root / "etc"
    for name, master in (("passwd", "passwd.master"), ("group", "group.master")):
        text = (root / "usr/share/base-passwd" / master).read_text().replace(":*:", ":x:")
        number = 100
        extra = {"passwd": f"messagebus:x:{number}:{number}::/nonexistent:/usr/sbin/nologin\n"
                           "guest:x:1000:1000::/tmp:/bin/sh\nstranger:x:1001:1001::/tmp:/bin/sh\n",
                 "group": f"messagebus:x:{number}:\nguest:x:1000:\nstranger:x:1001:\n"}
        (etc / name).write_text(text + extra[name])
    (etc / "nsswitch.conf").write_text("passwd: files systemd\ngroup: files systemd\nshadow: files\nhosts: files\n")
    (etc / "hostname").write_text("vm\n")
    (etc / "hosts").write_text("127.0.0.1 localhost vm\n")
    (etc / "fstab").write_text("")
    (etc / "machine-id").write_text("0123456789abcdef0123456789abcdef\n")
    units = etc / "systemd/system"
    for wants in units.glob("*.wants"):
        shutil.rmtree(wants)
    for unit in MASKED:
        (units / unit).unlink(missing_ok=True)
        (units / unit).symlink_to("/dev/null")
    (units / "scenarios.target").write_text(TARGET)
    (units / "scenarios.service").write_text(SERVICE)
    (units / "default.target").unlink(missing_ok=True)
    (units / "default.target").symlink_to("scenarios.target")
    # Everything that is said is kept: scenarios read it.
    journald = etc / "systemd/journald.conf.d"
    journald.mkdir()
    (journald / "all.conf").write_text("[Journal]\nStorage=volatile\nRateLimitIntervalSec=0\n")
    for name in ("dev", "proc", "sys", "run", "tmp", "var/log", "var/tmp", "root"):
        (root / name).mkdir(parents=True, exist_ok=True)
    shutil.rmtree(root / "var/run", ignore_errors=True)
    if not (root / "var/run").is_symlink():
        os.symlink("/run", root / "var/run")
