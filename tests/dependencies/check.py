#!/usr/bin/env python3
"""Checks the licences and sources of all crates that Cargo.lock names against deny.toml.

    check.py [--manifest python/Cargo.toml]

What `cargo deny check licenses bans sources` checks of deny.toml, in seconds: building cargo-deny takes longer than
building mocapd's own crates. `.ci/run long` runs cargo-deny itself.

Prints what is refused, then `N passed, N failed`, which are crates; the exit code is 1 if one failed.
"""

import argparse
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import license_expression

ROOT = Path(__file__).resolve().parents[2]
REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"
SPDX = license_expression.get_spdx_licensing()


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--manifest", default=ROOT / "Cargo.toml", type=Path)
    policy = tomllib.loads((ROOT / "deny.toml").read_text(encoding="utf-8"))
    command = ["cargo", "metadata", "--locked", "--all-features", "--format-version", "1", "--manifest-path"]
    done = subprocess.run([*command, arguments.parse_args().manifest], stdout=subprocess.PIPE, check=True)
    packages = json.loads(done.stdout)["packages"]
    failed = 0
    for package in packages:
        refused = list(refusals(package, policy))
        failed += bool(refused)
        for why in refused:
            print(f"{package['name']} {package['version']}: {why}")
    print(f"{len(packages) - failed} passed, {failed} failed")
    sys.exit(failed > 0 or not packages)


def refusals(package, policy):
    if package["source"] not in (None, REGISTRY):
        yield f"its source is {package['source']}"
    for needed in package["dependencies"]:
        if package["source"] is None and needed["req"] == "*" and not needed.get("path"):
            yield f"any version of {needed['name']} would do"
    allowed = set(policy["licenses"]["allow"])
    for exception in policy["licenses"]["exceptions"]:
        if exception["crate"] == package["name"]:
            allowed.update(exception["allow"])
    if not package["license"]:
        yield "no licence is named"
    elif not is_allowed(SPDX.parse(package["license"].replace("/", " OR "), validate=True), allowed):
        yield f"{package['license']} is not among the licences of deny.toml"


def is_allowed(expression, allowed):
    if isinstance(expression, SPDX.AND):
        return all(is_allowed(part, allowed) for part in expression.args)
    if isinstance(expression, SPDX.OR):
        return any(is_allowed(part, allowed) for part in expression.args)
    return str(expression) in allowed


if __name__ == "__main__":
    main()
