"""Compares mocapd's codec with published codecs on recorded takes.

    pip install -r benches/peers/requirements.txt
    python benches/peers/run.py TAKES_DIR --cache DIR --json OUT.json --markdown OUT.md --plot OUT

The tolerance bounds the Euclidean error of every sample. Each payload is decoded to float32 and its error measured.
With --check the exit code is 1 when a claim does not hold.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bars as bars_  # noqa: E402
import ours as ours_  # noqa: E402
import plot  # noqa: E402
import sizes  # noqa: E402
import table  # noqa: E402
import takes as takes_  # noqa: E402
import timings  # noqa: E402
from families.registry import all_codecs  # noqa: E402

# Rounds of the speed measurement of a take for the resamplers with a claim; the others are measured once.
ROUNDS = 3


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("takes", type=Path, help="folder of C3D, TRC, TSV and CSV takes")
    parser.add_argument("--only", metavar="WORD", help="only takes whose name contains WORD")
    parser.add_argument("--mocapd", metavar="PATH", help="default: target/release/mocapd")
    parser.add_argument("--peers-only", action="store_true", help="do not run mocapd")
    parser.add_argument("--codecs", metavar="NAMES", help="only these peers, separated by commas; size claims need all")
    parser.add_argument("--effort", type=int, choices=range(1, 10), default=1, help="of dense; sizes only beyond 1")
    parser.add_argument(
        "--guaranteed",
        action="store_true",
        help="peers at bound/sqrt(3) an axis only: minutes in place of hours, and without the claims on tuned peers",
    )
    parser.add_argument("--no-speed", action="store_true", help="sizes only")
    parser.add_argument("--cache", metavar="DIR", help="cache the sizes of the peers in this folder")
    parser.add_argument("--json", metavar="OUT", type=Path)
    parser.add_argument("--markdown", metavar="OUT", type=Path, help="default: standard output")
    parser.add_argument("--plot", metavar="OUT", type=Path, help="write OUT.svg and OUT.png")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a claim does not hold")
    return parser.parse_args()


def log(text):
    print(text, file=sys.stderr, flush=True)


def main():
    options = arguments()
    paths = [p for p in takes_.find(options.takes) if not options.only or options.only in p.stem]
    if not paths:
        log(f"{options.takes}: no takes in this folder")
        return 2
    program = None if options.peers_only else ours_.find(options.mocapd)

    names = options.codecs.split(",") if options.codecs else None
    peers = sizes.all_rows(paths, options.cache, log=log, names=names, tuned=not options.guaranteed)
    takes = [takes_.load(path) for path in paths]
    speeds, ours = [], []
    for path, take in zip(paths, takes):
        log(f"mocapd and speeds: {take.name}")
        timed = not (options.no_speed or options.effort > 1 or take.raw_bytes < bars_.SPEED_RAW_BYTES_MIN or take.filtered)
        theirs, answers = [], []
        # Speeds come last, in one process: for each take, peers and mocapd alternate, so that a slow phase of the
        # machine does not affect only one of them.
        for n in range(ROUNDS if timed else 1):
            theirs.append(timings.speed_rows(take, peers) if timed else [])
            if program:
                answers.append(ours_.run(program, path, (ours_.DENSE, ours_.FAST) if n else (), options.effort))
        speeds += timings.fastest(theirs, ("take", "tolerance_mm", "codec"))
        found = [ours_.rows_of(answer, take) for answer in answers]
        ours += timings.fastest(found, ("take", "tolerance_mm", "resampler"))
    bars = bars_.all_bars(ours, peers, speeds, names, options.effort, tuned=not options.guaranteed) if ours else []

    versions = sorted({codec.versions for codec in all_codecs()})
    text = table.everything(peers, ours, speeds, versions)
    if options.markdown:
        options.markdown.write_text(text)
    else:
        print(text)
    if options.json:
        answer = {"versions": versions, "peers": peers, "speeds": speeds, "mocapd": ours, "bars": bars_.as_json(bars)}
        options.json.write_text(json.dumps(answer, indent=1) + "\n")
    if options.plot:
        plot.draw(peers, ours, options.plot)
    print(bars_.as_text(bars))
    return 1 if options.check and not (bars and all(bar.held for bar in bars)) else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (FileNotFoundError, RuntimeError, AssertionError) as problem:
        log(problem)
        sys.exit(2)
