//! The streams on the network: outlets of the crate `labstream-core`, and one thread that sleeps until the next sample.

use std::io;
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use labstream_core::net::Outlet;
use mocapd_drivers::uri::StreamQuery;

use super::{LslDevice, Push};
use crate::NetworkOptions;
use crate::device::FateLog;
use crate::device::SentLog;
use crate::line::host_ns;

/// The longest sleep, which bounds the reaction time to a stop and to a reader.
const SLEEP_MAX: Duration = Duration::from_millis(10);

/// How long after its first reader the motion waits for readers of the other streams.
const OTHERS_NS: u64 = 1_000_000_000;

/// How long readers have to take what was pushed before an outlet closes: its threads look every 200 ms.
const DRAIN: Duration = Duration::from_millis(500);

/// Why serving failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LslServeError {
    /// The system gives no ports.
    #[error(
        "cannot open an LSL outlet ({source}): end programs with outlets, which need ports 16572 to 16604 of TCP and UDP"
    )]
    Outlet {
        /// The system's error.
        source: io::Error,
    },
    /// The log of sent frames could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}

/// The outlets of a source.
#[expect(missing_debug_implementations, reason = "an outlet of the crate has none")]
pub struct LslOutlets {
    outlets: Vec<Outlet>,
    names: Vec<String>,
    /// When the first reader came, since the outlets are open.
    first_reader_ns: Option<u64>,
}

impl LslOutlets {
    /// Opens an outlet for each stream.
    ///
    /// # Errors
    /// When the system gives no ports.
    pub fn open(device: &LslDevice) -> Result<Self, LslServeError> {
        let infos = device.infos();
        let names = infos.iter().map(|info| info.name.clone()).collect();
        Ok(Self { outlets: open(device)?, names, first_reader_ns: None })
    }

    /// The URI that a recorder opens.
    #[must_use]
    pub fn uri(&self) -> String {
        StreamQuery { names: self.names.clone(), ..StreamQuery::default() }.to_string()
    }

    /// Serves a source until `stop` is set.
    ///
    /// # Errors
    /// When outlets cannot be opened again after an outage, or the log fails.
    pub fn serve(
        mut self,
        device: &mut LslDevice,
        options: NetworkOptions,
        stop: &AtomicBool,
    ) -> Result<SentLog, LslServeError> {
        // A sleep must not be 50 us late. If the kernel refuses, it stays.
        rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
        let mut log = FateLog::begin(options.log).map_err(LslServeError::Log)?;
        if log.is_kept() {
            device.keep_frame_log();
        }
        while !stop.load(Ordering::Relaxed) {
            self.follow_readers(device);
            let outlets = &self.outlets;
            let wake_ns =
                device.poll(host_ns(), &mut |stream, push| match (outlets.get(stream), push) {
                    (Some(outlet), Push::One(sample)) => outlet.push(sample),
                    (Some(outlet), Push::Chunk(samples, time_s)) => {
                        outlet.push_chunk_fast(samples, time_s);
                    }
                    (None, _) => {}
                });
            self.follow_cable(device)?;
            log.add(device.take_fates()).map_err(LslServeError::Log)?;
            if options.once && device.has_ended() {
                break;
            }
            sleep(Duration::from_nanos(wake_ns.saturating_sub(host_ns())).min(SLEEP_MAX));
        }
        sleep(DRAIN);
        log.add(device.take_fates()).map_err(LslServeError::Log)?;
        log.finish().map_err(LslServeError::Log)?;
        Ok(device.log())
    }

    /// Starts the motion when its streams are read, and stops it when nobody reads them any more.
    fn follow_readers(&mut self, device: &mut LslDevice) {
        let n_read = self.outlets.iter().filter(|outlet| outlet.consumer_count() > 0).count();
        device.set_read(self.outlets.first().is_some_and(|outlet| outlet.consumer_count() > 0));
        if n_read == 0 {
            // After an outage the source goes on until its readers are back.
            if self.first_reader_ns.take().is_some() && device.is_reachable() {
                device.stop();
            }
            return;
        }
        let now_ns = host_ns();
        if self.first_reader_ns.is_none() && device.is_playing() {
            device.resume();
        }
        let since_ns = now_ns.saturating_sub(*self.first_reader_ns.get_or_insert(now_ns));
        let is_complete = n_read == self.outlets.len() || since_ns >= OTHERS_NS;
        if is_complete && !device.is_playing() && !device.has_ended() {
            device.start(now_ns);
        }
    }

    /// Closes the outlets while the source cannot be reached, and opens them again.
    fn follow_cable(&mut self, device: &LslDevice) -> Result<(), LslServeError> {
        if !device.is_reachable() && !self.outlets.is_empty() {
            // What was pushed arrives: then the log is right about it.
            sleep(DRAIN);
            self.outlets.clear();
        } else if device.is_reachable() && self.outlets.is_empty() {
            self.outlets = open(device)?;
            self.first_reader_ns = None;
        }
        Ok(())
    }
}

fn open(device: &LslDevice) -> Result<Vec<Outlet>, LslServeError> {
    let outlets = device.infos().into_iter().map(Outlet::new);
    let outlets: Vec<Outlet> =
        outlets.collect::<io::Result<_>>().map_err(|source| LslServeError::Outlet { source })?;
    let is_found =
        |outlet: &Outlet| outlet.info().v4service_port != 0 || outlet.info().v6service_port != 0;
    if outlets.iter().all(is_found) {
        return Ok(outlets);
    }
    // One that answers no question is of no use.
    Err(LslServeError::Outlet { source: io::ErrorKind::AddrInUse.into() })
}
