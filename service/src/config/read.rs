//! Reads a configuration from a file or text and the command line: first each key by itself, then keys that depend on
//! each other. All problems are reported at once.

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
use mocapd_take::motion::UpAxis;
use toml::{
    Spanned,
    de::{DeString, DeTable, DeValue},
};

use super::{
    ArchiveConfig, ArmConfig, Config, ConfigError, ConfigProblem, DeviceConfig,
    FoxglovePublishConfig, HttpConfig, LslPublishConfig, NameTemplate, NatNetPublishConfig,
    PROBLEMS_MAX, QtmPublishConfig, SourceLocation, TakeConfig, TriggerConfig,
    key::{Key, RawValue, found},
    keys::{KEYS, SECTIONS, SOCKET_BYTES_MAX, rig_name},
    problem::{excerpt, suggestion_or_list},
};
use crate::{log::Level, subject::SubjectFiles, units::duration_text};

/// The configuration file if none is named.
pub const CONFIG_PATH: &str = "/etc/mocapd/mocapd.toml";

/// Largest configuration in bytes: the example, with every key and its purpose, has 10 kB. The place of each problem is
/// found from the start of the text, which takes 50 ms where all of it is unknown keys.
pub const CONFIG_BYTES_MAX: usize = 64 << 10;

/// Values from the command line that replace those of the file, as typed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Overrides {
    /// `--device`, for `device.uri`.
    pub device: Option<String>,
    /// `--directory`, for `take.directory`.
    pub directory: Option<String>,
    /// `--listen`, for `http.listen`.
    pub listen: Option<String>,
}

/// Properties of the process and the file that defaults depend on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Environment {
    /// The first folder of `$STATE_DIRECTORY`, which persists.
    pub state_directory: Option<PathBuf>,
    /// The first folder of `$RUNTIME_DIRECTORY`, which is removed when the service stops.
    pub runtime_directory: Option<PathBuf>,
    /// The name of the configuration file without its extension.
    pub file_stem: Option<String>,
}

impl Environment {
    /// Reads the environment of this process, for a configuration file.
    #[must_use]
    pub fn of_process(file: &Path) -> Self {
        Self {
            state_directory: folder("STATE_DIRECTORY"),
            runtime_directory: folder("RUNTIME_DIRECTORY"),
            file_stem: file.file_stem().map(|stem| stem.to_string_lossy().into_owned()),
        }
    }
}

/// The first folder of a variable: systemd separates several by colons, and the first is the service's own. systemd
/// writes UTF-8 without control characters; any other value cannot be written to a configuration file.
fn folder(variable: &str) -> Option<PathBuf> {
    let value = env::var(variable).ok()?;
    let first = value.split(':').next().unwrap_or_default();
    (!first.is_empty() && !first.contains(char::is_control)).then(|| first.into())
}

impl Config {
    /// Reads a configuration file, with the environment of this process.
    ///
    /// # Errors
    /// The file cannot be read, or it has problems: all of them.
    pub fn load(file: &Path, overrides: &Overrides) -> Result<Self, ConfigError> {
        Self::read_file(file, overrides, |_| Vec::new())
    }

    /// Reads a configuration file as [`load`](Self::load) does, and the subject's files that it names, whose problems
    /// are reported together with all others.
    ///
    /// # Errors
    /// The file cannot be read, or it has problems: all of them.
    pub fn check(file: &Path, overrides: &Overrides) -> Result<Self, ConfigError> {
        Self::read_file(file, overrides, |config| {
            let mut problems = config.subject.problems();
            problems.extend(config.archive_problem().map(|problem| ("archive.url", problem)));
            problems
        })
    }

    fn read_file(
        file: &Path,
        overrides: &Overrides,
        check: impl FnOnce(&Self) -> Vec<(&'static str, String)>,
    ) -> Result<Self, ConfigError> {
        let unreadable = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => ConfigError::NotFound(file.to_owned()),
            _ => ConfigError::Unreadable { file: file.to_owned(), error },
        };
        let opened = plain_file::open(file).map_err(unreadable)?;
        let mut bytes = Vec::new();
        opened.take(CONFIG_BYTES_MAX as u64 + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        let name = file.display().to_string();
        Self::parse_and_check(&name, &bytes, &Environment::of_process(file), overrides, check)
    }

    /// Parses a configuration; errors call it `name`.
    ///
    /// # Errors
    /// [`Refused`](ConfigError::Refused), with all problems.
    pub fn parse(
        name: &str,
        bytes: &[u8],
        environment: &Environment,
        overrides: &Overrides,
    ) -> Result<Self, ConfigError> {
        Self::parse_and_check(name, bytes, environment, overrides, |_| Vec::new())
    }

    /// Parses a configuration; `check` returns further problems by key.
    fn parse_and_check(
        name: &str,
        bytes: &[u8],
        environment: &Environment,
        overrides: &Overrides,
        check: impl FnOnce(&Self) -> Vec<(&'static str, String)>,
    ) -> Result<Self, ConfigError> {
        let text = text(bytes).map_err(|problem| refused(name, vec![problem]))?;
        let (document, errors) = DeTable::parse_recoverable(text);
        // Syntax errors are reported alone: anything that follows from them would be a guess.
        if !errors.is_empty() {
            let problems = errors.iter().map(|error| syntax_problem(text, error)).collect();
            return Err(refused(name, problems));
        }
        let options = [
            ("device.uri", "--device", &overrides.device),
            ("take.directory", "--directory", &overrides.directory),
            ("http.listen", "--listen", &overrides.listen),
        ];
        let options = options.map(|(path, option, value)| {
            let value = value.as_deref().map(|value| DeValue::String(Cow::Borrowed(value)));
            (path, SourceLocation::Option(option), value)
        });
        let mut reader = ConfigReader { text, values: BTreeMap::new(), problems: Vec::new() };
        for (name, value) in document.get_ref() {
            reader.section(name, value);
        }
        for (path, place, value) in &options {
            if let Some(value) = value {
                reader.values.insert(path, (*place, value));
            }
        }
        let mut config = Self::blank().map_err(|problem| refused(name, vec![problem]))?;
        for key in KEYS {
            reader.key(key, &mut config);
        }
        reader.environment_defaults(&mut config, environment);
        reader.codec(&mut config);
        reader.pre_roll(&config);
        reader.listen(&config);
        reader.publish_control(&config);
        reader.publish_natnet(&config);
        for (path, message) in check(&config) {
            reader.refuse(path, message);
        }
        if reader.problems.is_empty() { Ok(config) } else { Err(refused(name, reader.problems)) }
    }

    /// A configuration whose values are all replaced key by key.
    fn blank() -> Result<Self, ConfigProblem> {
        let bug = |message| ConfigProblem { place: SourceLocation::Nowhere, key: None, message };
        let tolerance = Tolerance::from_mm(Tolerance::MIN_MM);
        let tolerance = tolerance.map_err(|error| bug(error.to_string()))?;
        Ok(Self {
            rig_name: String::new(),
            device: DeviceConfig::default(),
            take: TakeConfig {
                directory: PathBuf::new(),
                name: NameTemplate::parse("{date}").map_err(bug)?,
                codec: Settings { kind: ResamplerKind::default(), tolerance },
                angle_degrees: None,
                residuals: false,
                up_axis: UpAxis::Unknown,
                stretch: Duration::ZERO,
                sync: Duration::ZERO,
                keep_free_bytes: 0,
                reconnect: Duration::ZERO,
                max_length: None,
                trash_keep: Duration::ZERO,
            },
            subject: SubjectFiles::default(),
            arm: ArmConfig::default(),
            archive: ArchiveConfig::default(),
            http: HttpConfig::default(),
            trigger: TriggerConfig::default(),
            publish_qtm: QtmPublishConfig::default(),
            publish_natnet: NatNetPublishConfig::default(),
            publish_lsl: LslPublishConfig::default(),
            publish_foxglove: FoxglovePublishConfig::default(),
            log_level: Level::default(),
        })
    }
}

/// Collects values by key path, and their problems.
struct ConfigReader<'a> {
    text: &'a str,
    values: BTreeMap<&'static str, (SourceLocation, &'a DeValue<'a>)>,
    problems: Vec<ConfigProblem>,
}

impl<'a> ConfigReader<'a> {
    /// Reads the keys of a section, and reports unknown sections and keys.
    fn section(&mut self, name: &Spanned<DeString<'_>>, value: &'a Spanned<DeValue<'a>>) {
        let word = name.get_ref().as_ref();
        let known = SECTIONS.iter().map(|(section, _)| *section);
        // Sections of sections have names with a point.
        let is_above = |section: &&str| section.split_once('.').is_some_and(|(up, _)| up == word);
        let below: Vec<String> =
            known.clone().filter(is_above).map(|section| format!("[{section}]")).collect();
        if let (false, Some(table)) = (below.is_empty(), value.get_ref().as_table()) {
            for (inner, value) in table {
                let path = format!("{word}.{}", inner.get_ref());
                match known.clone().find(|section| *section == path) {
                    Some(section) => self.keys_of(section, inner, value),
                    None => {
                        let path = excerpt(&path);
                        self.refuse_name(
                            inner,
                            format!("unknown section [{path}]: write {}", below.join(", ")),
                        );
                    }
                }
            }
            return;
        }
        let Some(section) = known.clone().find(|section| *section == word) else {
            let message = match section_of(word) {
                Some(section) => format!("'{word}' is not in a section: move it below [{section}]"),
                None => {
                    let hint = suggestion_or_list(word, known);
                    format!("unknown section [{}]: {hint}", excerpt(word))
                }
            };
            return self.refuse_name(name, message);
        };
        self.keys_of(section, name, value);
    }

    /// Reads the keys of a known section.
    fn keys_of(
        &mut self,
        section: &'static str,
        name: &Spanned<DeString<'_>>,
        value: &'a Spanned<DeValue<'a>>,
    ) {
        let Some(table) = value.get_ref().as_table() else {
            let found = found(value.get_ref());
            let message = format!("{section} is {found}: write [{section}] above its keys");
            return self.refuse_name(name, message);
        };
        for (name, value) in table {
            let word = name.get_ref().as_ref();
            let here = KEYS.iter().filter(|key| key.section() == section);
            if let Some(key) = here.clone().find(|key| key.name() == word) {
                let place = SourceLocation::of_byte(self.text, value.span().start);
                self.values.insert(key.path, (place, value.get_ref()));
                continue;
            }
            let message = match section_of(word) {
                Some(other) => format!("'{word}' belongs in [{other}], not in [{section}]"),
                None => {
                    let hint = suggestion_or_list(word, here.map(Key::name));
                    format!("unknown key '{}' in [{section}]: {hint}", excerpt(word))
                }
            };
            self.refuse_name(name, message);
        }
    }

    fn refuse_name(&mut self, name: &Spanned<DeString<'_>>, message: String) {
        let place = SourceLocation::of_byte(self.text, name.span().start);
        self.problems.push(ConfigProblem { place, key: None, message });
    }

    /// Reads the value of a key, or its default.
    fn key(&mut self, key: &'static Key, config: &mut Config) {
        let read = |place, value: &DeValue<'_>, text: &str, config: &mut Config| {
            (key.field.read)(config, &RawValue { key, value, place, text })
        };
        let default = key.example();
        let done = match self.values.get(key.path) {
            Some((place, value)) => read(*place, value, self.text, config),
            None if !key.has_default() => Ok(()),
            None => match DeValue::parse(&default) {
                Ok(value) => read(SourceLocation::Nowhere, value.get_ref(), &default, config),
                Err(error) => Err(vec![syntax_problem(&default, &error)]),
            },
        };
        self.problems.extend(done.err().into_iter().flatten());
    }

    fn is_set(&self, path: &str) -> bool {
        self.values.contains_key(path)
    }

    /// Whether none of these keys has a problem.
    fn are_valid(&self, paths: &[&str]) -> bool {
        self.problems.iter().all(|problem| problem.key.is_none_or(|key| !paths.contains(&key)))
    }

    /// Reports a problem of a key at the location of its value.
    fn refuse(&mut self, path: &'static str, message: String) {
        let place = self.values.get(path).map_or(SourceLocation::Nowhere, |(place, _)| *place);
        self.problems.push(ConfigProblem { place, key: Some(path), message });
    }

    /// Fills in the defaults that depend on the environment.
    fn environment_defaults(&mut self, config: &mut Config, environment: &Environment) {
        if !self.is_set("rig.name") {
            let stem = environment.file_stem.as_deref().filter(|stem| *stem != "mocapd");
            let stem = stem.unwrap_or("rig");
            config.rig_name = stem.to_owned();
            if rig_name(stem).is_err() {
                let (stem, advice) = (excerpt(stem), advice("rig.name"));
                let message = format!(
                    "the file name, {stem}, cannot be the rig's name: set rig.name in the file; {advice}"
                );
                self.refuse("rig.name", message);
            }
        }
        if !self.is_set("take.directory") {
            let directory = environment.state_directory.clone();
            config.take.directory = directory.unwrap_or_else(|| PathBuf::from("."));
        }
        if !self.is_set("http.socket") {
            let folder = environment.runtime_directory.as_deref();
            let socket = folder.unwrap_or(Path::new("/run/mocapd")).join("mocapd.sock");
            if socket.as_os_str().len() > SOCKET_BYTES_MAX {
                let folder = excerpt(&folder.unwrap_or(&socket).to_string_lossy());
                let message = format!(
                    "RUNTIME_DIRECTORY is {folder}, too long for a socket path: {}",
                    advice("http.socket")
                );
                self.refuse("http.socket", message);
            }
            config.http.socket = Some(socket);
        }
    }

    /// Combines `lossless`, `resampler`, `tolerance` and `angle_tolerance`.
    fn codec(&mut self, config: &mut Config) {
        let keys = ["take.tolerance", "take.angle_tolerance", "take.lossless", "take.resampler"];
        if !self.are_valid(&keys) {
            return;
        }
        let codec = &mut config.take.codec;
        let (kind, value) = (codec.kind, self.values.get("take.lossless"));
        let value = value.and_then(|(_, value)| value.as_bool());
        if let Some(is_lossless) = value
            && self.is_set("take.resampler")
            && is_lossless != kind.is_lossless()
        {
            let message = format!(
                "lossless = {is_lossless} contradicts resampler = \"{kind}\": remove one of them"
            );
            self.refuse("take.lossless", message);
        } else if value == Some(true) || kind.is_lossless() {
            if self.is_set("take.tolerance") {
                let message = "a lossless take has no tolerance: remove tolerance or lossless";
                self.refuse("take.tolerance", message.to_owned());
            }
            if self.is_set("take.angle_tolerance") {
                let message = "a lossless take has no tolerance: remove angle_tolerance, or choose another resampler";
                self.refuse("take.angle_tolerance", message.to_owned());
            }
            // The tolerance is ignored. It is the smallest one, so that a mistake would cost bytes, not precision.
            let tolerance = Tolerance::from_mm(Tolerance::MIN_MM).unwrap_or(codec.tolerance);
            *codec = Settings { kind: ResamplerKind::Lossless, tolerance };
        }
    }

    fn pre_roll(&mut self, config: &Config) {
        let (kept, included) = (config.arm.pre_roll, config.arm.include_pre_roll);
        if !self.are_valid(&["arm.pre_roll", "arm.include_pre_roll"]) || included <= kept {
            return;
        }
        let message = format!(
            "include_pre_roll is {}, but only {} are kept: raise pre_roll or lower include_pre_roll",
            duration_text(included),
            duration_text(kept)
        );
        // If only one of the two is in the file, it is the one to change.
        let is_set = self.is_set("arm.include_pre_roll");
        self.refuse(if is_set { "arm.include_pre_roll" } else { "arm.pre_roll" }, message);
    }

    /// Control over the network needs a password.
    fn publish_control(&mut self, config: &Config) {
        if config.publish_qtm.control && !self.is_set("publish.qtm.password_file") {
            let message = "with control = true, whoever can connect could start and stop takes: \
                           set publish.qtm.password_file too";
            self.refuse("publish.qtm.control", message.to_owned());
        }
    }

    /// Frames to a group need one interface, and those to clients another port than commands.
    fn publish_natnet(&mut self, config: &Config) {
        let is_valid = self.are_valid(&["publish.natnet.listen", "publish.natnet.data_port"]);
        if let Some(message) = config.publish_natnet.data_port_problem().filter(|_| is_valid) {
            let is_set = self.is_set("publish.natnet.data_port");
            let key = if is_set { "publish.natnet.data_port" } else { "publish.natnet.listen" };
            self.refuse(key, message);
        }
        let is_valid = self.are_valid(&["publish.natnet.listen", "publish.natnet.multicast"]);
        if let Some(message) = config.publish_natnet.multicast_problem().filter(|_| is_valid) {
            self.refuse("publish.natnet.multicast", message);
        }
    }

    /// An address that other machines can reach needs a token.
    fn listen(&mut self, config: &Config) {
        if let Some(listen) = config.http.listen
            && !listen.ip().to_canonical().is_loopback()
            && !self.is_set("http.token_file")
        {
            let message = format!(
                "other machines can reach http.listen = {listen}: set http.token_file too, \
                 or listen on 127.0.0.1:{}",
                listen.port()
            );
            self.refuse("http.listen", message);
        }
    }
}

/// The section that a misplaced key belongs to.
fn section_of(word: &str) -> Option<&'static str> {
    KEYS.iter().find(|key| key.name() == word).map(Key::section)
}

fn advice(path: &str) -> String {
    KEYS.iter().find(|key| key.path == path).map(Key::advice).unwrap_or_default()
}

fn text(bytes: &[u8]) -> Result<&str, ConfigProblem> {
    let problem = |place, message| ConfigProblem { place, key: None, message };
    if bytes.len() > CONFIG_BYTES_MAX {
        let message = "the file is larger than 64 KiB: is it a configuration?";
        return Err(problem(SourceLocation::Nowhere, message.to_owned()));
    }
    std::str::from_utf8(bytes).map_err(|error| {
        let (valid, _) = bytes.split_at(error.valid_up_to());
        let valid = str::from_utf8(valid).unwrap_or_default();
        let message = "invalid UTF-8: save the file as UTF-8";
        problem(SourceLocation::of_byte(valid, valid.len()), message.to_owned())
    })
}

fn refused(name: &str, mut problems: Vec<ConfigProblem>) -> ConfigError {
    problems.sort_by_key(|problem| problem.place);
    let more = problems.len().saturating_sub(PROBLEMS_MAX);
    problems.truncate(PROBLEMS_MAX);
    ConfigError::Refused { name: name.to_owned(), problems, more }
}

fn syntax_problem(text: &str, error: &toml::de::Error) -> ConfigProblem {
    let at = error.span().map_or(0, |span| span.start);
    let message = error.message().lines().collect::<Vec<_>>().join(", ") + hint(text, at);
    ConfigProblem { place: SourceLocation::of_byte(text, at), key: None, message }
}

/// Explains the most frequent error: `pre_roll = 10s`, a value with a unit but without quotes.
fn hint(text: &str, byte: usize) -> &'static str {
    let start = text.get(..byte).and_then(|before| before.rfind('\n')).map_or(0, |at| at + 1);
    let line = text.get(start..).unwrap_or_default().lines().next().unwrap_or_default();
    let value = line.split_once('=').map_or("", |(_, value)| value.trim_start());
    let quoted = value.starts_with(['"', '\'', '[', '{']);
    let is_bare = !quoted && value.contains(|c: char| c.is_alphanumeric() || c == '/');
    if is_bare { "; texts and values with a unit need quotes, such as \"10s\"" } else { "" }
}
