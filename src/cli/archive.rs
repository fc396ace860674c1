//! `archive`: archives of many takes, by the Python package, which has the engines and tables that they need.

use std::{env, ffi::OsString, os::unix::process::CommandExt, process::Command};

use anyhow::anyhow;
use mocapd::outcome::Outcome;

#[derive(Debug, clap::Args)]
#[command(
    override_usage = "mocapd archive ingest|sql|verify|repack|collect [OPTIONS]",
    after_help = "\
Examples:
  mocapd archive ingest --bucket archive/ c3d/
  mocapd archive sql --bucket archive/ 'select source, frames from takes'
  mocapd archive verify --bucket archive/
  mocapd archive ingest --help

The Python package does the work, by the Python that MOCAPD_PYTHON names, else python3:
  pip install './python[archive]'"
)]
pub(crate) struct Args {
    /// A command, ingest, sql, verify, repack or collect, with its arguments; --help after it describes them
    #[arg(
        required = true,
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "COMMAND"
    )]
    arguments: Vec<OsString>,
}

/// Runs the package's command. Modules in the current folder, which may have others' data, are not the package's. A missing
/// package is one line, and not a list of calls.
const SCRIPT: &str = "\
import sys
sys.path[:] = [folder for folder in sys.path if folder]
try:
    from mocapd.archive.__main__ import main
except ImportError as error:
    sys.exit(f\"mocapd: archives need the Python package mocapd with the extra [archive] ({error}): \"
             f\"install it for {sys.executable}, or name another Python in MOCAPD_PYTHON\")
sys.exit(main())
";

/// Replaces this process by Python's.
///
/// # Errors
/// If Python cannot be run.
pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let python = env::var_os("MOCAPD_PYTHON").filter(|name| !name.is_empty());
    let python = python.unwrap_or_else(|| "python3".into());
    let failed = Command::new(&python).arg("-c").arg(SCRIPT).args(&args.arguments).exec();
    Err(anyhow!(
        "cannot run {} ({failed}): install Python 3.10 or newer, or name it in MOCAPD_PYTHON",
        python.display()
    ))
}
