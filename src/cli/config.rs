//! `config`: checks a configuration of the service, and prints an example.

use std::path::{Path, PathBuf};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_service::{
    config::{self, CONFIG_PATH, Config, ConfigError, ConfigProblem, Overrides, SourceLocation},
    http::{Token, TokenError},
};
use rustix::process::geteuid;
use serde::Serialize;
use serde_json::{Map, Value};

use super::{
    output::{notify, plain, print, print_json},
    values::count,
};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum ConfigCommand {
    /// Check a configuration: list every error in it, and valid settings that may have unexpected effects
    Check(CheckArgs),
    /// Print an example configuration with every key, its default and its purpose
    Example,
}

#[derive(Debug, clap::Args)]
pub(crate) struct CheckArgs {
    /// The configuration file
    #[arg(value_name = "FILE", default_value = CONFIG_PATH)]
    file: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct ConfigReport {
    file: String,
    good: bool,
    problems: Vec<ProblemReport>,
    notes: Vec<String>,
    /// The values by section and key; `None` if the configuration is invalid.
    config: Option<Value>,
}

#[derive(Debug, Serialize)]
struct ProblemReport {
    line: Option<usize>,
    column: Option<usize>,
    key: Option<&'static str>,
    message: String,
}

impl From<&ConfigProblem> for ProblemReport {
    fn from(problem: &ConfigProblem) -> Self {
        let (line, column) = match problem.place {
            SourceLocation::At { line, column } => (Some(line), Some(column)),
            SourceLocation::Option(_) | SourceLocation::Nowhere => (None, None),
        };
        Self { line, column, key: problem.key, message: problem.message.clone() }
    }
}

pub(crate) fn run(command: &ConfigCommand) -> anyhow::Result<Outcome> {
    match command {
        ConfigCommand::Check(args) => check(args),
        ConfigCommand::Example => print(&config::example()).map(|()| Outcome::Done),
    }
}

fn check(args: &CheckArgs) -> anyhow::Result<Outcome> {
    match Config::check(&args.file, &Overrides::default()) {
        Ok(config) => report_valid(args, &config),
        Err(error @ ConfigError::Refused { .. }) => report_invalid(args, &error),
        Err(error) => Err(error.into()),
    }
}

fn report_valid(args: &CheckArgs, config: &Config) -> anyhow::Result<Outcome> {
    let mut notes = config.warnings();
    if let Some(file) = &config.http.token_file {
        notes.extend(token_note(file)?);
    }
    if args.json {
        print_json(&ConfigReport {
            file: args.file.display().to_string(),
            good: true,
            problems: Vec::new(),
            notes,
            config: Some(by_section(config)),
        })?;
        return Ok(Outcome::Done);
    }
    for note in &notes {
        notify(&format!("note: {note}"));
    }
    print(&format!("{} is valid\n", plain(&args.file.display().to_string())))?;
    Ok(Outcome::Done)
}

/// Checks the token file as the service would. If root runs the check, another owner is only a note: the file may
/// belong to the service's user.
fn token_note(file: &Path) -> anyhow::Result<Option<String>> {
    match Token::read(file) {
        Ok(_) => Ok(None),
        Err(error @ TokenError::Foreign { .. }) if geteuid().is_root() => {
            Ok(Some(format!("{error}, unless that is the service's user")))
        }
        Err(error) => Err(error.into()),
    }
}

fn report_invalid(args: &CheckArgs, error: &ConfigError) -> anyhow::Result<Outcome> {
    let ConfigError::Refused { problems, more, .. } = error else {
        return Err(UsageError(error.to_string()).into());
    };
    if args.json {
        print_json(&ConfigReport {
            file: args.file.display().to_string(),
            good: false,
            problems: problems.iter().map(ProblemReport::from).collect(),
            notes: Vec::new(),
            config: None,
        })?;
    }
    let mut lines = error.lines();
    if lines.len() == 1 {
        return Err(UsageError(lines.remove(0)).into());
    }
    for line in &lines {
        notify(line);
    }
    let n = count((problems.len() + more) as u64, "problem");
    Err(UsageError(format!("{} is invalid: {n}, see above", args.file.display())).into())
}

/// Every key that has a value, as an object of sections; `publish.qtm` is a section within a section.
fn by_section(config: &Config) -> Value {
    let mut sections = Map::new();
    for (path, value) in config.values() {
        let (Some((section, name)), Some(value)) = (path.rsplit_once('.'), value) else { continue };
        let mut keys = Some(&mut sections);
        for part in section.split('.') {
            let section =
                keys.map(|keys| keys.entry(part).or_insert_with(|| Value::Object(Map::new())));
            keys = section.and_then(Value::as_object_mut);
        }
        if let Some(keys) = keys {
            keys.insert(name.to_owned(), value);
        }
    }
    Value::Object(sections)
}
