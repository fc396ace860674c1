//! From a file, or a text, and what the command line overrides, to a checked configuration: each key alone, then those
//! that depend on each other, and all that is wrong at once.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    env,
    io::{self, Read},
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_drivers::plain_file;
use toml::{
    Spanned,
    de::{DeString, DeTable, DeValue},
};

use super::{
    ArmConfig, Config, ConfigError, DeviceConfig, HttpConfig, NameTemplate, PROBLEMS_MAX, Place,
    Problem, TakeConfig, TriggerConfig,
    key::{Given, Key, found},
    keys::{KEYS, SECTIONS, SOCKET_BYTES_MAX, rig_name},
    problem::{meant, short},
};
use crate::{log::Level, subject::SubjectFiles, units::duration_text};

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

/// Of the process and the file, what defaults depend on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Surroundings {
    /// systemd's folder for what the service keeps.
    pub state_directory: Option<PathBuf>,
    /// systemd's folder for what is gone with the service.
    pub runtime_directory: Option<PathBuf>,
    /// The configuration's file name without its ending.
    pub file_stem: Option<String>,
}

impl Surroundings {
    /// Of this process and a file.
    #[must_use]
    pub fn of_process(file: &Path) -> Self {
        Self {
            state_directory: folder("STATE_DIRECTORY"),
            runtime_directory: folder("RUNTIME_DIRECTORY"),
            file_stem: file.file_stem().map(|stem| stem.to_string_lossy().into_owned()),
        }
    }
}

/// systemd gives more than one with colons between them: the first is the service's own. It writes UTF-8, and no
/// control character into it; whatever else somebody set cannot be written into a file.
fn folder(variable: &str) -> Option<PathBuf> {
    let value = env::var(variable).ok()?;
    let first = value.split(':').next().unwrap_or_default();
    (!first.is_empty() && !first.contains(char::is_control)).then(|| first.into())
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
        let text = text(bytes).map_err(|problem| refused(name, vec![problem]))?;
        let (document, errors) = DeTable::parse_recoverable(text);
        // Where its TOML is broken, that is all that is told: what follows from it would be guessed.
        if !errors.is_empty() {
            let problems = errors.iter().map(|error| broken(text, error)).collect();
            return Err(refused(name, problems));
        }
        let options = [
            ("device.uri", "--device", &overrides.device),
            ("take.directory", "--directory", &overrides.directory),
            ("http.listen", "--listen", &overrides.listen),
        ];
        let options = options.map(|(path, option, said)| {
            let value = said.as_deref().map(|said| DeValue::String(Cow::Borrowed(said)));
            (path, Place::Option(option), value)
        });
        let mut reading = Reading { text, given: BTreeMap::new(), problems: Vec::new() };
        for (name, value) in document.get_ref() {
            reading.section(name, value);
        }
        for (path, place, value) in &options {
            if let Some(value) = value {
                reading.given.insert(path, (*place, value));
            }
        }
        let mut config = Self::unread().map_err(|problem| refused(name, vec![problem]))?;
        for key in KEYS {
            reading.key(key, &mut config);
        }
        reading.surroundings(&mut config, surroundings);
        reading.codec(&mut config);
        reading.pre_roll(&config);
        reading.listen(&config);
        if reading.problems.is_empty() { Ok(config) } else { Err(refused(name, reading.problems)) }
    }

    /// What every key then replaces by its value.
    fn unread() -> Result<Self, Problem> {
        let bug = |message| Problem { place: Place::Nowhere, key: None, message };
        let tolerance = Tolerance::from_mm(Tolerance::MIN_MM);
        Ok(Self {
            rig_name: String::new(),
            device: DeviceConfig::default(),
            take: TakeConfig {
                directory: PathBuf::new(),
                name: NameTemplate::parse("{date}").map_err(bug)?,
                codec: Settings {
                    kind: ResamplerKind::default(),
                    tolerance: tolerance.map_err(|error| bug(error.to_string()))?,
                },
                stretch: Duration::ZERO,
                sync: Duration::ZERO,
                keep_free_bytes: 0,
                reconnect: Duration::ZERO,
                max_length: None,
            },
            subject: SubjectFiles::default(),
            arm: ArmConfig::default(),
            http: HttpConfig::default(),
            trigger: TriggerConfig::default(),
            log_level: Level::default(),
        })
    }
}

/// What is given for keys, by their paths, and what is wrong with it.
struct Reading<'a> {
    text: &'a str,
    given: BTreeMap<&'static str, (Place, &'a DeValue<'a>)>,
    problems: Vec<Problem>,
}

impl<'a> Reading<'a> {
    /// Keys of a section of the document, and what is no key of ours.
    fn section(&mut self, name: &Spanned<DeString<'_>>, value: &'a Spanned<DeValue<'a>>) {
        let word = name.get_ref().as_ref();
        let known = SECTIONS.iter().map(|(section, _)| *section);
        let Some(section) = known.clone().find(|section| *section == word) else {
            let message = match of_section(word) {
                Some(section) => format!("'{word}' stands in no section: put it under [{section}]"),
                None => format!("unknown section [{}]: {}", short(word), meant(word, known)),
            };
            return self.refuse_name(name, message);
        };
        let Some(table) = value.get_ref().as_table() else {
            let found = found(value.get_ref());
            return self.refuse_name(
                name,
                format!("{section} is {found}: write [{section}] above its keys"),
            );
        };
        for (name, value) in table {
            let word = name.get_ref().as_ref();
            let here = KEYS.iter().filter(|key| key.section() == section);
            if let Some(key) = here.clone().find(|key| key.name() == word) {
                let place = Place::of_byte(self.text, value.span().start);
                self.given.insert(key.path, (place, value.get_ref()));
                continue;
            }
            let message = match of_section(word) {
                Some(other) => format!("'{word}' is no key of [{section}]: it stands in [{other}]"),
                None => format!(
                    "unknown key '{}' in [{section}]: {}",
                    short(word),
                    meant(word, here.map(Key::name))
                ),
            };
            self.refuse_name(name, message);
        }
    }

    fn refuse_name(&mut self, name: &Spanned<DeString<'_>>, message: String) {
        let place = Place::of_byte(self.text, name.span().start);
        self.problems.push(Problem { place, key: None, message });
    }

    /// The value of a key, or its default.
    fn key(&mut self, key: &'static Key, config: &mut Config) {
        let read = |place, value: &DeValue<'_>, text: &str, config: &mut Config| {
            (key.field.read)(config, &Given { key, value, place, text })
        };
        let default = key.example();
        let done = match self.given.get(key.path) {
            Some((place, value)) => read(*place, value, self.text, config),
            None if !key.has_default() => Ok(()),
            None => match DeValue::parse(&default) {
                Ok(value) => read(Place::Nowhere, value.get_ref(), &default, config),
                Err(error) => Err(vec![broken(&default, &error)]),
            },
        };
        self.problems.extend(done.err().into_iter().flatten());
    }

    fn is_given(&self, path: &str) -> bool {
        self.given.contains_key(path)
    }

    /// Whether nothing is wrong with these.
    fn are_good(&self, paths: &[&str]) -> bool {
        self.problems.iter().all(|problem| problem.key.is_none_or(|key| !paths.contains(&key)))
    }

    /// Says what is wrong with a key, where it stands.
    fn refuse(&mut self, path: &'static str, message: String) {
        let place = self.given.get(path).map_or(Place::Nowhere, |(place, _)| *place);
        self.problems.push(Problem { place, key: Some(path), message });
    }

    /// Defaults that depend on where mocapd runs.
    fn surroundings(&mut self, config: &mut Config, surroundings: &Surroundings) {
        if !self.is_given("rig.name") {
            let stem = surroundings.file_stem.as_deref().filter(|stem| *stem != "mocapd");
            let stem = stem.unwrap_or("rig");
            config.rig_name = stem.to_owned();
            if rig_name(stem).is_err() {
                let (stem, advice) = (short(stem), advice("rig.name"));
                let message = format!(
                    "the file's name, {stem}, can be no rig's: give rig.name in the file; {advice}"
                );
                self.refuse("rig.name", message);
            }
        }
        if !self.is_given("take.directory") {
            let directory = surroundings.state_directory.clone();
            config.take.directory = directory.unwrap_or_else(|| PathBuf::from("."));
        }
        if !self.is_given("http.socket") {
            let folder = surroundings.runtime_directory.as_deref();
            let socket = folder.unwrap_or(Path::new("/run/mocapd")).join("mocapd.sock");
            if socket.as_os_str().len() > SOCKET_BYTES_MAX {
                let folder = short(&folder.unwrap_or(&socket).to_string_lossy());
                let message = format!(
                    "RUNTIME_DIRECTORY is {folder}, too long for a socket in it: {}",
                    advice("http.socket")
                );
                self.refuse("http.socket", message);
            }
            config.http.socket = Some(socket);
        }
    }

    /// `lossless`, `resampler` and `tolerance` together.
    fn codec(&mut self, config: &mut Config) {
        if !self.are_good(&["take.tolerance", "take.lossless", "take.resampler"]) {
            return;
        }
        let codec = &mut config.take.codec;
        let (kind, said) = (codec.kind, self.given.get("take.lossless"));
        let said = said.and_then(|(_, value)| value.as_bool());
        if let Some(is_lossless) = said
            && self.is_given("take.resampler")
            && is_lossless != kind.is_lossless()
        {
            let message = format!(
                "lossless = {is_lossless} and resampler = \"{kind}\" say different things: take one out"
            );
            self.refuse("take.lossless", message);
        } else if said == Some(true) || kind.is_lossless() {
            if self.is_given("take.tolerance") {
                let message = "a take that is lossless keeps every bit and has no tolerance: take one of them out";
                self.refuse("take.tolerance", message.to_owned());
            }
            // Its tolerance is ignored; the smallest there is, so that a mistake would cost bytes and no precision.
            let tolerance = Tolerance::from_mm(Tolerance::MIN_MM).unwrap_or(codec.tolerance);
            *codec = Settings { kind: ResamplerKind::Lossless, tolerance };
        }
    }

    fn pre_roll(&mut self, config: &Config) {
        let (kept, included) = (config.arm.pre_roll, config.arm.include_pre_roll);
        if !self.are_good(&["arm.pre_roll", "arm.include_pre_roll"]) || included <= kept {
            return;
        }
        let message = format!(
            "include_pre_roll is {} and only {} are kept: raise pre_roll or lower it",
            duration_text(included),
            duration_text(kept)
        );
        // Where only one of them stands in the file, it is that one.
        let is_given = self.is_given("arm.include_pre_roll");
        self.refuse(if is_given { "arm.include_pre_roll" } else { "arm.pre_roll" }, message);
    }

    /// Other machines need a token.
    fn listen(&mut self, config: &Config) {
        if let Some(listen) = config.http.listen
            && !listen.ip().to_canonical().is_loopback()
            && !self.is_given("http.token_file")
        {
            let message = format!(
                "http.listen is {listen}, which other machines reach: give http.token_file too, \
                 or listen on 127.0.0.1:{}",
                listen.port()
            );
            self.refuse("http.listen", message);
        }
    }
}

/// The section of a key that was written elsewhere.
fn of_section(word: &str) -> Option<&'static str> {
    KEYS.iter().find(|key| key.name() == word).map(Key::section)
}

fn advice(path: &str) -> String {
    KEYS.iter().find(|key| key.path == path).map(Key::advice).unwrap_or_default()
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
        problem(Place::of_byte(valid, valid.len()), message.to_owned())
    })
}

fn refused(name: &str, mut problems: Vec<Problem>) -> ConfigError {
    problems.sort_by_key(|problem| problem.place);
    let more = problems.len().saturating_sub(PROBLEMS_MAX);
    problems.truncate(PROBLEMS_MAX);
    ConfigError::Refused { name: name.to_owned(), problems, more }
}

fn broken(text: &str, error: &toml::de::Error) -> Problem {
    let at = error.span().map_or(0, |span| span.start);
    let words = error.message().lines().collect::<Vec<_>>().join(", ");
    Problem { place: Place::of_byte(text, at), key: None, message: words + hint(text, at) }
}

/// For what people write most often: `pre_roll = 10s`, a value with a unit and without quotes.
fn hint(text: &str, byte: usize) -> &'static str {
    let start = text.get(..byte).and_then(|before| before.rfind('\n')).map_or(0, |at| at + 1);
    let line = text.get(start..).unwrap_or_default().lines().next().unwrap_or_default();
    let value = line.split_once('=').map_or("", |(_, value)| value.trim_start());
    let quoted = value.starts_with(['"', '\'', '[', '{']);
    let is_bare = !quoted && value.contains(|c: char| c.is_alphanumeric() || c == '/');
    if is_bare { "; texts, and values with a unit, stand in quotes, such as \"10s\"" } else { "" }
}
