//! Sources of motion: files, whose format follows from the extension, and the generator.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use mocapd_drivers::plain_file;
use mocapd_take::interchange::{Format, InterchangeError};
use mocapd_take::motion::Motion;

/// Why a motion could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The file's extension is that of no known format.
    #[error("{}: unknown file extension: use .take, .c3d, .trc, .tsv or .csv", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be opened or read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The content does not match the extension.
    #[error("{}", path.display())]
    Interchange {
        /// The file.
        path: PathBuf,
        /// The format's error.
        source: InterchangeError,
    },
    /// The take is unreadable.
    #[error("{}", path.display())]
    Take {
        /// The file.
        path: PathBuf,
        /// The take's error.
        source: mocapd_take::TakeError,
    },
}

/// Whether a file has the extension of a motion format.
#[must_use]
pub fn is_motion(path: &Path) -> bool {
    is_take(path) || Format::from_extension(path).is_some_and(Format::is_read)
}

fn is_take(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("take"))
}

/// Reads a whole motion; returns it with one warning for each problem that reading tolerated.
///
/// # Errors
/// When the extension is unknown, or the file cannot be read.
pub fn read(path: &Path) -> Result<(Motion, Vec<String>), SourceError> {
    let owned = || path.to_owned();
    let format = Format::from_extension(path).filter(|format| format.is_read());
    if !is_motion(path) {
        return Err(SourceError::Extension { path: owned() });
    }
    let read = |source| SourceError::Read { path: owned(), source };
    let Some(format) = format.filter(|_| !is_take(path)) else {
        let file = plain_file::open(path).map_err(read)?;
        let (motion, problems) = mocapd_take::read_motion(BufReader::new(file))
            .map_err(|source| SourceError::Take { path: owned(), source })?;
        return Ok((motion, problems.iter().map(ToString::to_string).collect()));
    };
    let mut bytes = Vec::new();
    plain_file::open(path).and_then(|mut file| file.read_to_end(&mut bytes)).map_err(read)?;
    let motion =
        format.read(&bytes).map_err(|source| SourceError::Interchange { path: owned(), source })?;
    let warnings = motion.info.source.warnings.clone();
    Ok((motion, warnings))
}

/// Truncates a motion to its first seconds, but at least one frame if it has any.
pub fn keep_first(motion: &mut Motion, seconds: f64) {
    let requested = (seconds * motion.info.rate_hz).round().max(1.0);
    // A float beyond usize saturates, which truncates nothing.
    let n_frames = motion.n_frames().min(requested as usize);
    motion.positions_mm.truncate(n_frames * motion.info.markers.len());
    motion.info.n_frames = n_frames as u64;
}

/// The argument of `--generate`: `jump` or `jump:SEED`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Generated {
    /// Seed of the jump, 1 by default.
    pub seed: u64,
}

impl FromStr for Generated {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, seed) = text.split_once(':').unwrap_or((text, "1"));
        if name != "jump" {
            return Err(format!("unknown motion '{name}', expected jump or jump:SEED"));
        }
        let bad = |_| format!("invalid seed '{seed}': expected 0 to {}", u64::MAX);
        Ok(Self { seed: seed.parse().map_err(bad)? })
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::recorded::RecordedData;

    use super::*;
    use crate::device::{Device, DeviceSettings};
    use crate::generator::JumpSpec;

    #[test]
    fn the_extension_selects_the_format_and_errors_name_the_file() {
        let error = read(Path::new("/nowhere/jump.xyz")).unwrap_err().to_string();
        assert_eq!(
            error,
            "/nowhere/jump.xyz: unknown file extension: use .take, .c3d, .trc, .tsv or .csv"
        );
        for extension in ["take", "TAKE", "c3d", "trc", "tsv", "csv"] {
            let error = read(Path::new(&format!("/nowhere/jump.{extension}"))).unwrap_err();
            assert!(matches!(error, SourceError::Read { .. }), "{extension}: {error}");
        }
    }

    #[test]
    fn recorded_motions_of_every_format_become_devices() {
        let Some(folder) = RecordedData::Takes.folder() else { return };
        let mut formats = std::collections::BTreeSet::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let Some(format) = Format::from_extension(&path) else { continue };
            let (motion, _) = read(&path).unwrap();
            let n_frames = motion.n_frames() as u64;
            let device = Device::new(motion, DeviceSettings::default());
            let device = device.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert_eq!(device.hello().n_frames, n_frames, "{}", path.display());
            formats.insert(format!("{format:?}"));
        }
        assert_eq!(formats.len(), 4, "{formats:?}");
    }

    #[test]
    fn generated_motions_are_named() {
        assert_eq!("jump".parse(), Ok(Generated { seed: 1 }));
        assert_eq!("jump:77".parse(), Ok(Generated { seed: 77 }));
        assert!("walk:1".parse::<Generated>().unwrap_err().contains("jump:"));
        assert!("jump:-1".parse::<Generated>().is_err());
    }

    #[test]
    fn the_first_seconds_are_kept() {
        let mut motion = JumpSpec::new(1, 60.0).generate().unwrap().motion;
        let whole = motion.clone();
        keep_first(&mut motion, 1e9);
        assert_eq!(motion, whole);
        keep_first(&mut motion, 2.0);
        assert_eq!((motion.n_frames(), motion.info.n_frames), (120, 120));
        assert_eq!(motion.positions_mm, whole.positions_mm[..120 * 15]);
        keep_first(&mut motion, 0.0);
        assert_eq!(motion.n_frames(), 1);
    }
}
