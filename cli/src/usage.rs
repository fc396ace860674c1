//! clap's error messages in one line.

use std::io;

use clap::{
    Parser,
    error::{Error, ErrorKind},
};

/// What the arguments ask for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Parsed<P> {
    /// To run with these arguments.
    Arguments(P),
    /// Help or version, which were printed: the program ends with this exit code.
    Printed(u8),
}

/// Why there are no arguments to work with.
#[derive(Debug, thiserror::Error)]
pub enum ParseError {
    /// What is wrong with the arguments, in one line that ends with what to do.
    #[error("{0}")]
    Usage(String),
    /// Help or version could not be printed.
    #[error("cannot write to standard output: {0}")]
    Output(#[from] io::Error),
}

/// Parses the arguments of the program; prints help and version if asked to.
///
/// # Errors
/// [`ParseError`].
pub fn parse<P: Parser>() -> Result<Parsed<P>, ParseError> {
    let error = match P::try_parse() {
        Ok(arguments) => return Ok(Parsed::Arguments(arguments)),
        Err(error) => error,
    };
    match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => match error.print() {
            // A closed pipe (`| head`) is not an error.
            Err(failed) if failed.kind() != io::ErrorKind::BrokenPipe => Err(failed.into()),
            _ => Ok(Parsed::Printed(error.exit_code() as u8)),
        },
        _ => Err(ParseError::Usage(one_line(&error))),
    }
}

/// Joins the paragraphs of an error message of clap into one line that ends with what to do.
#[must_use]
pub fn one_line(error: &Error) -> String {
    let message = error.render().to_string();
    let mut out = String::new();
    for line in message.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if line.starts_with("Usage:") || line.starts_with("For more information") {
            break;
        }
        if !out.is_empty() {
            out.push_str(if line.starts_with("tip:") { "; " } else { " " });
        }
        out.push_str(line);
    }
    // The message about an invalid value says what to type; these others do not.
    if matches!(
        error.kind(),
        ErrorKind::MissingRequiredArgument
            | ErrorKind::UnknownArgument
            | ErrorKind::InvalidSubcommand
            | ErrorKind::TooManyValues
            | ErrorKind::WrongNumberOfValues
    ) {
        out.push_str("; try --help");
    }
    out.strip_prefix("error: ").unwrap_or(&out).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Parser)]
    #[command(name = "rig")]
    enum Rig {
        /// Imports
        Import {
            file: String,
            #[arg(short, long, value_name = "TAKE")]
            output: String,
            #[arg(long, value_name = "N")]
            threads: Option<u16>,
            #[arg(long)]
            json: bool,
        },
    }

    fn message_of(args: &[&str]) -> String {
        let args = ["rig"].iter().chain(args);
        one_line(&Rig::try_parse_from(args).unwrap_err())
    }

    #[test]
    fn every_refusal_is_one_line() {
        for (args, expected) in [
            (
                &["import"][..],
                "the following required arguments were not provided: --output <TAKE> <FILE>; try --help",
            ),
            (&["frob"], "unrecognized subcommand 'frob'; try --help"),
            (
                &["import", "a.csv", "--jsn"],
                "unexpected argument '--jsn' found; tip: a similar argument exists: '--json'; try --help",
            ),
            (
                &["import", "a.csv", "-o", "a.take", "--threads", "x"],
                "invalid value 'x' for '--threads <N>': invalid digit found in string",
            ),
        ] {
            assert_eq!(message_of(args), expected);
        }
    }
}
