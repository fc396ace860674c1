//! The token file: a secret that only the service may read.

use std::{
    fmt,
    fs::File,
    io::{self, Read},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use rustix::{
    fs::{Mode, OFlags, open},
    process::geteuid,
};

/// Bytes of a token file: a token and a line end.
const FILE_BYTES_MAX: u64 = 1024;

/// Letters of a token: sixteen of base64 are 96 bits, which nobody tries out.
const TOKEN_BYTES_MIN: usize = 16;

/// What callers over TCP must know. It is never printed.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// Why a token file is not used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// There is none, or it cannot be read.
    #[error("cannot read the token file {}: {error}; make one with `(umask 077; openssl rand -hex 32 > {})`", .file.display(), .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why; it is in the message, and so no source of its own.
        error: io::Error,
    },
    /// It is a folder, a pipe, a device.
    #[error("the token file {} is no plain file", .0.display())]
    NotAFile(PathBuf),
    /// Others may read or change it.
    #[error("the token file {} has mode {mode:04o}, and others may use it: chmod 600 {}", .file.display(), .file.display())]
    Open {
        /// The file.
        file: PathBuf,
        /// Its mode.
        mode: u32,
    },
    /// It is somebody else's, who may change it.
    #[error("the token file {} belongs to user {owner}, and the service runs as user {user}: chown it", .file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Whose it is.
        owner: u32,
        /// Who asks.
        user: u32,
    },
    /// What is in it is no token.
    #[error("the token file {} {why}: write one line of at least 16 letters, digits or signs without spaces", .file.display())]
    NoToken {
        /// The file.
        file: PathBuf,
        /// What is in it.
        why: &'static str,
    },
}

impl Token {
    /// Reads and checks a token file.
    ///
    /// # Errors
    /// Why it is not used, and what to do.
    pub fn read(file: &Path) -> Result<Self, TokenError> {
        Self::read_as(file, geteuid().as_raw())
    }

    /// The same for a service that runs as another user, as far as this one may read it.
    fn read_as(file: &Path, user: u32) -> Result<Self, TokenError> {
        let unreadable = |error| TokenError::Unreadable { file: file.to_owned(), error };
        // A pipe that nobody writes to would be waited for.
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let mut opened =
            File::from(open(file, flags, Mode::empty()).map_err(|e| unreadable(e.into()))?);
        // Of what is open, so that it cannot be another file by now.
        let meta = opened.metadata().map_err(unreadable)?;
        if !meta.is_file() {
            return Err(TokenError::NotAFile(file.to_owned()));
        }
        let mode = meta.mode() & 0o7777;
        if mode & !0o600 != 0 {
            return Err(TokenError::Open { file: file.to_owned(), mode });
        }
        if meta.uid() != user {
            return Err(TokenError::Foreign { file: file.to_owned(), owner: meta.uid(), user });
        }
        let mut text = String::new();
        let limited = opened.by_ref().take(FILE_BYTES_MAX + 1).read_to_string(&mut text);
        let no_token = |why| TokenError::NoToken { file: file.to_owned(), why };
        limited.map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData => no_token("holds no text"),
            _ => unreadable(error),
        })?;
        let token = text.strip_suffix('\n').unwrap_or(&text);
        let token = token.strip_suffix('\r').unwrap_or(token);
        if text.len() as u64 > FILE_BYTES_MAX {
            return Err(no_token("has more than 1024 bytes"));
        }
        if token.len() < TOKEN_BYTES_MIN {
            return Err(no_token("is too short"));
        }
        if !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(no_token("has spaces, more lines or other letters in it"));
        }
        Ok(Self(token.to_owned()))
    }

    /// The token itself, for whoever compares it with what callers say.
    #[must_use]
    pub fn into_text(self) -> String {
        self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use super::*;

    const SECRET: &str = "0123456789abcdef";

    fn file(mode: u32, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("token");
        fs::write(&path, content).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        (dir, path)
    }

    #[track_caller]
    fn refused(mode: u32, content: &[u8], words: &str) {
        let (_dir, path) = file(mode, content);
        let said = Token::read(&path).unwrap_err().to_string();
        assert!(said.contains(words) && said.contains("token file"), "{said}");
    }

    #[test]
    fn a_secret_file_is_read_and_never_shown() {
        for (mode, content) in [(0o600, "0123456789abcdef\n"), (0o400, SECRET)] {
            let (_dir, path) = file(mode, content.as_bytes());
            let token = Token::read(&path).unwrap();
            assert_eq!(format!("{token:?}"), "Token(..)");
            assert_eq!(token.into_text(), SECRET);
        }
    }

    #[test]
    fn what_others_may_read_or_change_is_refused() {
        for mode in [0o640, 0o604, 0o620, 0o602, 0o644, 0o700, 0o1600] {
            refused(mode, SECRET.as_bytes(), "chmod 600");
        }
        let (_dir, path) = file(0o600, SECRET.as_bytes());
        let owner = fs::metadata(&path).unwrap().uid();
        let said = Token::read_as(&path, owner + 1).unwrap_err().to_string();
        assert!(said.contains("chown"), "{said}");
    }

    #[test]
    fn what_is_no_token_is_refused() {
        refused(0o600, b"", "too short");
        refused(0o600, b"0123456789abcde\n", "too short");
        refused(0o600, b"0123456789 abcdef", "spaces");
        refused(0o600, b"0123456789abcdef\n0123456789abcdef\n", "more lines");
        refused(0o600, &[0xff; 32], "no text");
        refused(0o600, &[b'x'; 1025], "1024");
    }

    #[test]
    fn what_is_no_file_is_refused_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let missing = Token::read(&dir.path().join("none")).unwrap_err().to_string();
        assert!(missing.contains("openssl rand"), "{missing}");
        assert!(matches!(Token::read(dir.path()), Err(TokenError::NotAFile(_))));
        let pipe = dir.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg("-m600").arg(&pipe).status();
        assert!(made.unwrap().success());
        assert!(matches!(Token::read(&pipe), Err(TokenError::NotAFile(_))));
    }
}
