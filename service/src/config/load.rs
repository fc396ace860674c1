//! From a file, or a text, and what the command line overrides, to a checked configuration.

use std::{
    io::{self, Read},
    path::Path,
};

use mocapd_drivers::plain_file;

use super::{
    Config, ConfigError, PROBLEMS_MAX, Place, Problem, Surroundings, check,
    keys::{DEVICE_URI, HTTP_LISTEN, Key, TAKE_DIRECTORY},
    reader::Reader,
    value::{Entry, Value},
    written::{Written, place},
};

/// Where the configuration is when nobody says otherwise.
pub const CONFIG_PATH: &str = "/etc/mocapd/mocapd.toml";

/// Bytes of a configuration: the example, which has every key with what it is for, has 10 kB.
pub const CONFIG_BYTES_MAX: usize = 1 << 20;

/// What the command line says instead of the file, as it was typed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Overrides {
    /// `--device`, for `device.uri`.
    pub device: Option<String>,
    /// `--directory`, for `take.directory`.
    pub directory: Option<String>,
    /// `--listen`, for `http.listen`.
    pub listen: Option<String>,
}

impl Overrides {
    fn each(&self) -> [(&'static Key, &'static str, &Option<String>); 3] {
        [
            (&DEVICE_URI, "--device", &self.device),
            (&TAKE_DIRECTORY, "--directory", &self.directory),
            (&HTTP_LISTEN, "--listen", &self.listen),
        ]
    }
}

impl Config {
    /// Reads a file, for this process.
    ///
    /// # Errors
    /// That it cannot be read, or everything that is wrong with it.
    pub fn load(file: &Path, overrides: &Overrides) -> Result<Self, ConfigError> {
        let unreadable = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => ConfigError::NotFound(file.to_owned()),
            _ => ConfigError::Unreadable { file: file.to_owned(), error },
        };
        let opened = plain_file::open(file).map_err(unreadable)?;
        let mut bytes = Vec::new();
        opened.take(CONFIG_BYTES_MAX as u64 + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        let name = file.display().to_string();
        Self::parse(&name, &bytes, &Surroundings::of_process(file), overrides)
    }

    /// Reads a text; errors call it `name`.
    ///
    /// # Errors
    /// [`Refused`](ConfigError::Refused), with everything that is wrong with it.
    pub fn parse(
        name: &str,
        bytes: &[u8],
        surroundings: &Surroundings,
        overrides: &Overrides,
    ) -> Result<Self, ConfigError> {
        let text = match text(bytes) {
            Ok(text) => text,
            Err(problem) => return Err(refused(name, vec![problem])),
        };
        let Written { mut entries, problems, is_broken } = Written::read(text);
        for (key, option, given) in overrides.each() {
            if let Some(given) = given {
                let value = Value::Text(given.clone());
                entries.insert(key.path, Entry { value, place: Place::Option(option) });
            }
        }
        let mut reader = Reader { entries, problems };
        let config = if is_broken { None } else { check::check(&mut reader, surroundings) };
        match config {
            Some(config) if reader.problems.is_empty() => Ok(config),
            _ => Err(refused(name, reader.problems)),
        }
    }
}

fn text(bytes: &[u8]) -> Result<&str, Problem> {
    let problem = |place, message| Problem { place, key: None, message };
    if bytes.len() > CONFIG_BYTES_MAX {
        let message = "a configuration has at most 1 MiB, and this has more: is it another file?";
        return Err(problem(Place::Nowhere, message.to_owned()));
    }
    std::str::from_utf8(bytes).map_err(|error| {
        let (valid, _) = bytes.split_at(error.valid_up_to());
        let valid = str::from_utf8(valid).unwrap_or_default();
        let message = "here is a byte that is no UTF-8: save the file as UTF-8";
        problem(place(valid, valid.len()), message.to_owned())
    })
}

fn refused(name: &str, mut problems: Vec<Problem>) -> ConfigError {
    problems.sort_by_key(|problem| problem.place);
    let more = problems.len().saturating_sub(PROBLEMS_MAX);
    problems.truncate(PROBLEMS_MAX);
    ConfigError::Refused { name: name.to_owned(), problems, more }
}
