//! How a system on the network is served, and the log of what became of its frames.

use std::{
    fmt,
    io::{self, Write},
};

use crate::device::FrameFate;

/// How to serve a system on the network.
#[derive(Default)]
pub struct NetworkOptions {
    /// Return when the motion has ended and what can be delivered was.
    pub once: bool,
    /// Destination of the log: the fate of every frame, one CSV row each.
    pub log: Option<Box<dyn Write + Send>>,
}

impl fmt::Debug for NetworkOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let log = self.log.is_some();
        f.debug_struct("NetworkOptions").field("once", &self.once).field("log", &log).finish()
    }
}

/// The log, if one is kept.
pub(crate) struct FateLog(Option<Box<dyn Write + Send>>);

impl FateLog {
    /// Writes the names of the columns.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn begin(mut out: Option<Box<dyn Write + Send>>) -> io::Result<Self> {
        out.iter_mut().try_for_each(|out| writeln!(out, "{}", FrameFate::CSV_HEADER))?;
        Ok(Self(out))
    }

    pub(crate) fn is_kept(&self) -> bool {
        self.0.is_some()
    }

    /// Adds the fates of frames.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn add(&mut self, fates: impl IntoIterator<Item = FrameFate>) -> io::Result<()> {
        let Some(out) = &mut self.0 else { return Ok(()) };
        fates.into_iter().try_for_each(|fate| writeln!(out, "{}", fate.to_csv()))
    }

    /// Writes the rest out.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn finish(self) -> io::Result<()> {
        self.0.into_iter().try_for_each(|mut out| out.flush())
    }
}
