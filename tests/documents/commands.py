#!/usr/bin/env python3
"""Runs the commands of the documents as they are written, each document in a folder of its own.

Most commands wait for a simulated device, so three documents run at a time. Documents that use the same path below /tmp,
or the port of the service, run one after another.

A command is a line of a block marked `sh`, or an indented line that begins with the name of a program. Each is either run
or listed here with the reason why not; a command that is neither fails the check.

    python3 tests/documents/commands.py --programs target/release [--subject FOLDER]

--programs: the folder of mocapd and mocapd-sim. --subject: a folder with scan.obj and portrait.png; without it, the
commands about a subject are skipped.
"""

import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

ROOT = pathlib.Path(__file__).resolve().parents[2]

DOCUMENTS = [
    "README.md",
    "CONTRIBUTING.md",
    "systemd/README.md",
    *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/*.md")),
    *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("*/README.md") if path.parent.name != "systemd"),
]

# The first words of an indented line that is a command.
PROGRAMS = r"(?:[A-Z_]+=\S+ )*(?:sleep|mocapd|mocapd-sim|cargo|curl|python3?|pip|sudo|apt|dpkg|systemctl|journalctl|\./mocapd\S*|\.ci/run)\b"

# (document, beginning of the command, reason): a regular expression each. The first that matches counts.
NOT_RUN = [
    (r".*", r"cargo (build|test|fmt|clippy|run|bench|install|doc|\+nightly)|MOCAPD_\w+=\S+ (cargo|python)", "built, tested or measured by other steps, or by hand for hours"),
    (r".*", r"\.ci/run", "is what runs this"),
    (r".*", r"export PATH=", "the programs are found already"),
    (r".*", r"(venv/bin/)?pip |python3? -m (venv|pip)|MOCAPD=\S+ python", "the step of the Python package"),
    (r"docs/getting-started.md", r"python3 -c 'import mocapd", "needs the Python package; its tests read takes so"),
    (r"docs/getting-started.md", r"mkdir -p ~|for program in", "writes into the home folder; tests/cli/manual.rs runs the commands"),
    (r"docs/getting-started.md", r"mocapd bench pipeline", "measures for minutes"),
    (r"systemd/README.md", r".*", "changes the machine; the emulated machine does"),
    (r"docs/hardware-in-the-loop.md", r".*", "needs a Raspberry Pi"),
    (r"docs/archive.md", r"mocapd archive", "needs the Python package; python/tests/archive runs the same functions"),
    (r"docs/api.md", r".*", "needs the installed service; tests/api/check.py asks the same routes"),
    (r"docs/benchmarks.md|benches/README.md", r".*", "needs recorded takes and hours"),
    (r"docs/reliability.md", r".*", "hours: .ci/run long"),
    (r"docs/subject-(body|face|face-model).md", r"python3 (benches|subject)/|python3 \S*/subject/", "learns from data that is not in the project"),
    (r"docs/paper-study.md", r"mocapd study cmu|awk|mocapd study ten", "needs recorded takes"),
    (r"docs/paper-study.md", r"mocapd-sim generate|mocapd study jumps", "takes minutes; tests/cli/studies.rs runs a part of it"),
    (r"docs/accuracy.md", r"for mm in", "FILE is the reader's own"),
    (r"docs/accuracy.md", r"mocapd (import|verify) \$", "inside of a loop that is not run"),
    (r"docs/ndi.md", r"mocapd record --device 'serial:/dev/", "needs an NDI system"),
    (r"docs/faults.md", r"mocapd verify noisy.take", "needs a recording of a simulator that logged; tests/cli/faults.rs does it"),
    (r"docs/ndi.md", r"mocapd-sim serve run.take", "continues with a take of an NDI system"),
    (r"docs/ndi.md", r"mocapd record --device 'serial:/tmp/ndi\?driver", "continues with a take of an NDI system"),
    (r"docs/lsl.md", r"mocapd record --device", "needs streams of LSL"),
    (r"docs/lsl.md", r"mocapd-sim serve", "serves until it is stopped"),
    (r"docs/natnet.md", r"mocapd record --device", "needs a NatNet server"),
    (r"docs/natnet.md", r"mocapd-sim serve", "serves until it is stopped"),
    (r"docs/qtm.md", r"mocapd record --device", "needs a QTM"),
    (r"docs/qtm.md", r"mocapd-sim serve|sudo sysctl", "serves until it is stopped; changes the machine"),
    (r"docs/archive.md", r"sudo", "changes the machine"),
    (r"docs/plots.md", r"mocapd (import|plot pose) singing", "needs a recorded face"),
]

# What a document expects to be there.
PREPARATION = {
    "docs/accuracy.md": "mocapd-sim generate --subjects 1 --jumps 1 --rate 120 --out jumps && cp jumps/*.c3d jump.c3d",
    "docs/columns.md": "mocapd-sim generate --subjects 1 --jumps 1 --rate 120 --out jumps && mocapd import jumps/*.c3d -o run.take",
    "docs/player.md": "mocapd demo && mkdir takes trials && cp mocapd-demo/*.take . && cp *.take takes && cp mocapd-demo/*.c3d trials",
    "docs/sharing.md": "mocapd demo && cp mocapd-demo/*.take .",
}

# Commands that do not end by themselves: they run behind those that follow, once they answer.
ENDLESS = {
    r"mocapd run ": "curl -sS --retry 20 --retry-delay 1 --retry-connrefused -o /dev/null http://127.0.0.1:7060/healthz",
    r"mocapd-sim serve [^&]*$": "sleep 1",
    r"mocapd view ": "sleep 1",
}


def commands(document: str) -> list[tuple[int, str, str]]:
    """The commands of a document: the number of the first line, the text, and the heading above."""
    found, block, in_block, fence, section = [], [], False, False, ""
    for number, line in enumerate((ROOT / document).read_text(encoding="utf-8").splitlines(), 1):
        if not fence and line.startswith("#"):
            section = line
        if line.startswith("```"):
            in_block = line.strip() in ("```sh", "```bash") and not fence
            fence = not fence
            block = []
        elif in_block:
            block.append(line)
            text = "\n".join(block)
            if not text.strip() or text.lstrip().startswith("#"):
                block = []
            elif subprocess.run(["bash", "-n", "-c", text], capture_output=True, check=False).returncode == 0:
                found.append((number - len(block) + 1, text, section))
                block = []
        elif not fence and re.match(r"    " + PROGRAMS, line):
            found.append((number, line.strip(), section))
    return found


def reason(document: str, command: str) -> str | None:
    """Why a command is not run; None if it is."""
    for place, beginning, why in NOT_RUN:
        if re.fullmatch(place, document) and re.match(beginning, command.strip()):
            return why
    return None


def accepted_codes(command: str) -> str:
    """The exit codes that the remark beside a command announces."""
    announced = re.search(r"#.*exit code (\d)( if)?", command)
    if not announced:
        # A simulated NDI system is polled in real time: beside other work some of its frames come too late, which the
        # ledger states.
        return "0 3" if "record" in command and "driver=ndi" in command else "0"
    return f"0 {announced[1]}" if announced[2] else announced[1]


def script(document: str, lines: list[tuple[int, str, str]]) -> str:
    """A shell script that runs the commands one after another and stops at the first with an unexpected exit code. What
    runs in the background ends with its section."""
    parts = ["set -m", "check() { local code=$1 at=$2; shift 2; for one; do [[ $code != \"$one\" ]] || return 0; done",
             "  echo \"FAILED: line $at: exit code $code, expected $*\" >&2; exit 1; }",
             "end() { for job in $(jobs -p); do kill -- \"-$job\" 2>/dev/null; done; wait; }", "trap end EXIT"]
    if document in PREPARATION:
        parts += [PREPARATION[document], "check $? 0 0"]
    before = lines[0][2]
    for number, command, section in lines:
        if section != before:
            parts.append("end")
        before = section
        ready = next((ready for start, ready in ENDLESS.items() if re.match(start, command)), None)
        if ready:
            bare = re.sub(r"\s+#.*$", "", command)
            parts += [f"{bare} &", ready, f"check $? {number} 0"]
        else:
            parts += [command, f"check $? {number} {accepted_codes(command)}"]
    return "\n".join(parts) + "\n"


def groups(documents: dict[str, list[tuple[int, str, str]]]) -> list[list[str]]:
    """Lists of documents. Those that use the same path or port are in one list, and must not run at the same time."""
    found: list[tuple[set[str], list[str]]] = []
    for document, lines in documents.items():
        text = "\n".join(command for _, command, _ in lines)
        places = set(re.findall(r"/tmp/\w+", text)) | ({"port"} if re.search(r"mocapd run ", text) else set())
        together = [document]
        for group in [group for group in found if group[0] & places]:
            found.remove(group)
            places |= group[0]
            together = group[1] + together
        found.append((places, together))
    # The largest first.
    return sorted((together for _, together in found), key=lambda group: -sum(len(documents[one]) for one in group))


def run(document: str, lines: list[tuple[int, str, str]], programs: pathlib.Path, subject: pathlib.Path | None) -> bool:
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        # The project's files under their own paths; what the commands write stays here.
        for entry in ROOT.iterdir():
            if entry.name not in {".git", "target", "mocapd-demo", "sizes"}:
                (folder / entry.name).symlink_to(entry)
        if subject:
            (folder / "scan.obj").write_bytes((subject / "scan.obj").read_bytes())
            (folder / "portrait.jpg").write_bytes((subject / "portrait.png").read_bytes())
        env = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
        began = time.monotonic()
        with subprocess.Popen(["bash", "-c", script(document, lines)], cwd=folder, env=env, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True, start_new_session=True) as shell:
            try:
                stdout, stderr = shell.communicate(timeout=300)
            except subprocess.TimeoutExpired:
                # `set -m` gives each command its own process group; only the session has them all.
                subprocess.run(["pkill", "-KILL", "-s", str(shell.pid)], check=False)
                stdout, stderr = shell.communicate()
        held = shell.returncode == 0
        shown = f"{'ok' if held else 'FAILED'}: {document}: {len(lines)} commands, {time.monotonic() - began:.0f} s"
        if not held:
            shown += f"\n{stdout[-2000:]}\n{stderr[-2000:]}"
        print(shown, flush=True)
        return held


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--programs", type=pathlib.Path, required=True)
    parser.add_argument("--subject", type=pathlib.Path)
    parser.add_argument("documents", nargs="*", default=DOCUMENTS)
    args = parser.parse_args()
    programs, subject = args.programs.resolve(), args.subject and args.subject.resolve()
    n_listed = 0
    to_run: dict[str, list[tuple[int, str, str]]] = {}
    for document in args.documents:
        lines = []
        for number, command, section in commands(document):
            why = reason(document, command)
            if why is None and "mocapd subject" in command and subject is None:
                why = "there is no scan and no photograph"
            if why is None:
                lines.append((number, command, section))
            else:
                n_listed += 1
        if lines:
            to_run[document] = lines
    with ThreadPoolExecutor(3) as pool:
        jobs = [pool.submit(lambda group=group: [run(one, to_run[one], programs, subject) for one in group])
                for group in groups(to_run)]
        failed = sum(not held for job in jobs for held in job.result())
    n_run = sum(map(len, to_run.values()))
    print(f"{n_listed} commands are not run here, for the reasons listed in {pathlib.Path(__file__).name}")
    print(f"{n_run if not failed else n_run - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
