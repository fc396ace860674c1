//! clap's error messages in one line.

use clap::error::{Error, ErrorKind};

/// Joins the paragraphs of an error message of clap into one line that ends with what to do.
pub(super) fn one_line(error: &Error) -> String {
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
    use clap::Parser;

    use super::*;
    use crate::cli::Cli;

    fn message_of(args: &[&str]) -> String {
        let args = ["mocapd"].iter().chain(args);
        one_line(&Cli::try_parse_from(args).unwrap_err())
    }

    #[test]
    fn every_refusal_is_one_line() {
        for (args, expected) in [
            (
                &["import"][..],
                "the following required arguments were not provided: <FILE>...; try --help",
            ),
            (&["frob"], "unrecognized subcommand 'frob'; try --help"),
            (
                &["info", "a.take", "--jsn"],
                "unexpected argument '--jsn' found; tip: a similar argument exists: '--json'; try --help",
            ),
            (
                &["import", "a.csv", "-o", "a.take", "--tolerance", "0"],
                "invalid value '0' for '--tolerance <LENGTH>': a tolerance of 0 keeps every bit: use --lossless",
            ),
        ] {
            assert_eq!(message_of(args), expected);
        }
    }
}
