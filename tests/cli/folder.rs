//! A temporary folder for each test, and the program run in it.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs,
    io::Cursor,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use mocapd_take::{
    interchange::Format,
    motion::{Motion, MotionFrames},
};

/// The result of a run of the program.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("the program speaks UTF-8");
        Self {
            code: output.status.code(),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        }
    }
}

impl Ran {
    /// Asserts the exit code.
    #[track_caller]
    pub(crate) fn with_code(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}{}", self.stdout, self.stderr);
        self
    }

    /// Standard output parsed as one JSON document.
    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}", self.stdout))
    }
}

/// A temporary folder: the program's working folder, so that arguments are plain names.
#[derive(Debug)]
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap();
    }

    pub(crate) fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub(crate) fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    /// Writes a motion in the format of the name's extension.
    pub(crate) fn write_motion(&self, name: &str, motion: &Motion) {
        self.write(name, file_of(Path::new(name), motion));
    }

    /// A command that runs the program in this folder.
    pub(crate) fn command<S: AsRef<OsStr>>(&self, args: &[S]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd"));
        command.args(args).current_dir(self.0.path());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub(crate) fn run(&self, args: &[&str]) -> Ran {
        self.command(args).output().unwrap().into()
    }

    /// Runs a command that must fail: with `code`, nothing on stdout, one line on stderr, and the folder unchanged.
    /// Returns the line.
    #[track_caller]
    pub(crate) fn refuses(&self, args: &[&str], code: i32) -> String {
        self.refused(self.command(args), code)
    }

    /// Runs any command that must fail in this way.
    #[track_caller]
    pub(crate) fn refused(&self, mut command: Command, code: i32) -> String {
        let before = self.content();
        let ran: Ran = command.output().unwrap().into();
        let message = ran.stderr.clone();
        assert_eq!(ran.code, Some(code), "{command:?}: {}{message}", ran.stdout);
        assert_eq!(ran.stdout, "", "{command:?} printed on stdout");
        assert_eq!(message.lines().count(), 1, "{command:?}: not one line: {message}");
        let line = message.strip_prefix("mocapd: ").and_then(|rest| rest.strip_suffix('\n'));
        let line = line.unwrap_or_else(|| panic!("{command:?}: {message:?}"));
        assert!(!line.ends_with('.') && !line.is_empty(), "{command:?}: {line}");
        let after = self.content();
        assert!(before == after, "{command:?}: {:?} became {:?}", before.keys(), after.keys());
        line.to_owned()
    }

    /// Every file, hidden ones included, with its bytes; for a folder or a link its kind instead.
    pub(crate) fn content(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut content = BTreeMap::new();
        let mut folders = vec![self.0.path().to_owned()];
        while let Some(folder) = folders.pop() {
            let Ok(entries) = fs::read_dir(&folder) else { continue };
            for entry in entries {
                let path = entry.unwrap().path();
                let kind = path.symlink_metadata().unwrap().file_type();
                let bytes = if kind.is_file() && !kind.is_fifo() {
                    fs::read(&path).unwrap_or_default()
                } else {
                    format!("{kind:?}").into_bytes()
                };
                if kind.is_dir() {
                    folders.push(path.clone());
                }
                content.insert(path, bytes);
            }
        }
        content
    }
}

/// A motion in the format of a name's extension.
fn file_of(name: &Path, motion: &Motion) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let format = Format::from_extension(name).expect("an ending that is known");
    format.write(&mut MotionFrames::new(motion), &mut bytes).unwrap();
    bytes.into_inner()
}
