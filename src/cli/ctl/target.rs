//! Where the service is.

use std::{
    env, fmt,
    path::{Path, PathBuf},
};

use mocapd::outcome::UsageError;

/// Where services put their sockets.
const SOCKETS: &str = "/run/mocapd";

/// Where one listens that has no socket.
const LOOPBACK: &str = "127.0.0.1:7060";

/// An address to connect to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Target {
    /// A Unix socket.
    Unix(PathBuf),
    /// A host and a port.
    Tcp(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(host) => write!(f, "http://{host}"),
        }
    }
}

impl Target {
    /// What was said, or where a service is to be expected.
    pub(super) fn find(said: Option<&str>) -> anyhow::Result<Self> {
        if let Some(said) = said {
            return Ok(Self::parse(said).map_err(UsageError)?);
        }
        if let Some(path) = env::var_os("MOCAPD_SOCKET").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(path.into()));
        }
        Ok(Self::expected(Path::new(SOCKETS)).map_err(UsageError)?)
    }

    /// # Errors
    /// What is wrong and what to type.
    fn parse(said: &str) -> Result<Self, String> {
        if let Some(path) = said.strip_prefix("unix:") {
            let path = path.strip_prefix("//").unwrap_or(path);
            return if path.is_empty() {
                Err(format!("'{said}' names no socket: give unix:PATH"))
            } else {
                Ok(Self::Unix(path.into()))
            };
        }
        let wrong = || format!("'{said}' is no address: give unix:PATH or http://HOST:PORT");
        let host = said.strip_prefix("http://").ok_or_else(wrong)?.trim_end_matches('/');
        let authority: axum::http::uri::Authority = host.parse().map_err(|_| wrong())?;
        if authority.host().is_empty() || host.contains('@') {
            return Err(wrong());
        }
        Ok(Self::Tcp(if authority.port_u16().is_some() {
            host.to_owned()
        } else {
            format!("{host}:80")
        }))
    }

    /// The only socket in the folder; loopback where there is none.
    ///
    /// # Errors
    /// Which there are, when there are several.
    fn expected(folder: &Path) -> Result<Self, String> {
        let is_socket =
            |path: &PathBuf| path.extension().is_some_and(|extension| extension == "sock");
        let within = |folder: &Path| -> Vec<PathBuf> {
            let entries = folder.read_dir().into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect()
        };
        let mut sockets = within(folder);
        // A unit has a folder of its own: /run/mocapd/NAME/mocapd.sock.
        sockets.extend(sockets.clone().iter().flat_map(|folder| within(folder)));
        sockets.retain(is_socket);
        sockets.sort();
        match &sockets[..] {
            [] => Ok(Self::Tcp(LOOPBACK.to_owned())),
            [only] => Ok(Self::Unix(only.clone())),
            several => {
                let names: Vec<_> = several
                    .iter()
                    .map(|path| format!("--connect unix:{}", path.display()))
                    .collect();
                Err(format!("several services listen here: say which, {}", names.join(" or ")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        let parse = |said| Target::parse(said).map(|target| target.to_string());
        assert_eq!(parse("unix:/run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("unix:///run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("http://rig:7060/").unwrap(), "http://rig:7060");
        assert_eq!(parse("http://[::1]:7060").unwrap(), "http://[::1]:7060");
        assert_eq!(parse("http://rig").unwrap(), "http://rig:80");
        for said in [
            "",
            "rig:7060",
            "unix:",
            "https://rig",
            "http://",
            "http://a b",
            "http://u@rig",
            "http://rig/x",
        ] {
            assert!(Target::parse(said).is_err(), "{said}");
        }
    }

    #[test]
    fn the_only_socket_is_the_one_that_is_meant() {
        let folder = tempfile::tempdir().unwrap();
        let expected = || Target::expected(folder.path());
        assert_eq!(expected().unwrap(), Target::Tcp(LOOPBACK.to_owned()));
        std::fs::write(folder.path().join("note.txt"), "").unwrap();
        let units = folder.path().join("hall/mocapd.sock");
        std::fs::create_dir(folder.path().join("hall")).unwrap();
        std::fs::write(&units, "").unwrap();
        assert_eq!(expected().unwrap(), Target::Unix(units), "a unit's");
        std::fs::write(folder.path().join("b.sock"), "").unwrap();
        let several = expected().unwrap_err();
        assert!(several.contains("hall/mocapd.sock") && several.contains("b.sock"), "{several}");
        std::fs::remove_dir_all(folder.path().join("hall")).unwrap();
        assert_eq!(expected().unwrap(), Target::Unix(folder.path().join("b.sock")));
        assert_eq!(
            Target::expected(Path::new("/nowhere")).unwrap(),
            Target::Tcp(LOOPBACK.to_owned())
        );
    }
}
