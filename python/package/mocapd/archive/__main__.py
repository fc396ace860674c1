"""``mocapd archive``: archives on the command line."""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import asdict
from typing import Any

import pyarrow as pa

from . import StoreError, catalogue, collect, ingest, repack, verify
from ._sources import BATCH_FILES
from ._upkeep import YOUNG_S

_DONE, _FAILED, _USAGE, _LOST = 0, 1, 2, 3


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="mocapd archive", description="Ingest motion files into an archive, and query it")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, help: str, run: Any) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help)
        added.set_defaults(run=run)
        added.add_argument("-b", "--bucket", metavar="URL", help="the archive: a folder or a URL [default: $MOCAPD_ARCHIVE]")
        return added

    def workers(added: argparse.ArgumentParser) -> None:
        added.add_argument(
            "--workers", type=int, metavar="N", help="Ray workers [default: one per core]; 0: this process, without Ray"
        )

    added = command("ingest", "Import motion files and takes into an archive, each once", _ingest)
    added.add_argument("sources", nargs="+", metavar="SOURCE", help="files and folders, as paths or URLs")
    added.add_argument("--tolerance", metavar="LENGTH", help="largest error of a sample: 0.5mm, 100um [default: 0.5mm]")
    added.add_argument("--resampler", default="dense", metavar="NAME", help="dense, fast, lossless or lossless:predictive")
    added.add_argument("--lossless", action="store_true", help="as --resampler lossless:predictive")
    added.add_argument("--effort", type=int, metavar="N", help="effort of the resampler dense, 1 to 9 [default: 3]")
    added.add_argument("--keys", metavar="TIME", help="longest time from one key stretch to the next: 2s, 500ms, none")
    added.add_argument("--unit", metavar="UNIT", help="unit of length of the files, if they state none or a wrong one")
    added.add_argument("--up", metavar="AXIS", help="axis that points up in the files")
    added.add_argument("--analog-tolerance", action="append", default=[], metavar="[PATTERN=]VALUE")
    added.add_argument("--drop-foreign", action="store_true", help="import marker trajectories only")
    added.add_argument("--names", metavar="REGEX", help="groups (?P<subject>...) and (?P<session>...) of the sources' names")
    added.add_argument("--batch-files", type=int, default=BATCH_FILES, metavar="N", help="files of a task [default: 64]")
    added.add_argument("--json", action="store_true", help="print the report as JSON")
    workers(added)
    added = command("sql", "Query the catalogue: the table is catalogue, its takes are in takes", _sql)
    added.add_argument("query")
    added.add_argument("--json", action="store_true", help="print a JSON document for each row")
    added = command("verify", "Verify every take of an archive", _verify)
    added.add_argument("--json", action="store_true", help="print the report as JSON")
    workers(added)
    added = command("repack", "Write takes again in fewer bytes; samples stay unchanged", _repack)
    added.add_argument("--json", action="store_true", help="print the report as JSON")
    workers(added)
    added = command("collect", "List, and with --remove remove, the takes that no row of the catalogue names", _collect)
    added.add_argument("--remove", action="store_true")
    added.add_argument("--ignore-leases", action="store_true", help="although an ingest or a repack seems to be running")
    added.add_argument("--older-than", type=float, default=YOUNG_S, metavar="SECONDS", help="[default: a day]")
    added.add_argument("--json", action="store_true", help="print a JSON document for each object")
    return parser


def _report(args: argparse.Namespace, report: Any) -> None:
    print(json.dumps(asdict(report)) if args.json else report)


def _ingest(args: argparse.Namespace) -> int:
    if args.lossless:
        args.resampler = "lossless:predictive"
    is_lossless = args.resampler.partition(":")[0] == "lossless"
    if is_lossless and args.tolerance is not None:
        raise ValueError("a lossless take has no tolerance: omit --tolerance")
    if args.batch_files < 1 or (args.workers is not None and args.workers < 0):
        raise ValueError("expected a batch of a file or more, and workers of 0 or more")
    report = ingest(
        args.sources,
        args.bucket,
        tolerance=None if is_lossless else args.tolerance or "0.5mm",
        resampler=args.resampler,
        effort=args.effort,
        keys=args.keys,
        unit=args.unit,
        up=args.up,
        analog_tolerance=tuple(args.analog_tolerance),
        drop_foreign=args.drop_foreign,
        names=args.names,
        workers=args.workers,
        batch_files=args.batch_files,
        progress=sys.stderr.isatty(),
    )
    _report(args, report)
    for source, error in report.errors:
        print(f"{source}: {error}", file=sys.stderr)
    if report.failed_before:
        print("failed before: mocapd archive sql 'select source, error from failures'", file=sys.stderr)
    return _FAILED if report.failed or report.failed_before else _DONE


def _sql(args: argparse.Namespace) -> int:
    found = catalogue(args.bucket).sql(args.query)
    if args.json:
        for row in found.to_pylist():
            print(json.dumps(row, default=str))
    else:
        from pyarrow import csv

        # CSV has no lists and structs: their JSON.
        columns = {
            name: pa.array([json.dumps(value, default=str) for value in column.to_pylist()])
            if pa.types.is_nested(column.type)
            else column
            for name, column in zip(found.column_names, found.columns)
        }
        csv.write_csv(pa.table(columns), sys.stdout.buffer)
    return _DONE


def _verify(args: argparse.Namespace) -> int:
    report = verify(args.bucket, workers=args.workers)
    _report(args, report)
    for name, problem in report.damaged:
        print(f"{name}: {problem}", file=sys.stderr)
    for name in report.missing:
        print(f"{name}: missing", file=sys.stderr)
    return _DONE if report.is_intact else _LOST


def _repack(args: argparse.Namespace) -> int:
    report = repack(args.bucket, workers=args.workers)
    _report(args, report)
    for name, error in report.failed:
        print(f"{name}: {error}", file=sys.stderr)
    return _FAILED if report.failed else _DONE


def _collect(args: argparse.Namespace) -> int:
    found = collect(args.bucket, remove=args.remove, older_than_s=args.older_than, ignore_leases=args.ignore_leases)
    for entry in found:
        print(json.dumps(asdict(entry)) if args.json else entry.name)
    if not args.json:
        n_bytes = sum(entry.n_bytes for entry in found)
        print(f"{len(found)} objects of {n_bytes / 1e6:.1f} MB {'removed' if args.remove else 'found'}", file=sys.stderr)
    return _DONE


def _joined(words: list[str]) -> list[str]:
    """The words of a command line, with ``--up -z`` as ``--up=-z``: argparse would take ``-z`` for an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] == "--up" and "--" not in joined and re.fullmatch("-[xyzXYZ]", word):
            joined[-1] = f"--up={word}"
        else:
            joined.append(word)
    return joined


def main() -> int:
    args = _parser().parse_args(_joined(sys.argv[1:]))
    try:
        return int(args.run(args))
    except ValueError as error:
        print(f"mocapd: {error}", file=sys.stderr)
        return _USAGE
    except (OSError, StoreError, ImportError) as error:
        print(f"mocapd: {error}", file=sys.stderr)
        return _FAILED
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
