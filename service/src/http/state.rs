//! What every route sees.

use std::sync::Arc;

use axum::body::Bytes;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use super::{
    auth::Auth, counts::Counts, happenings::Happenings, lanes::Lanes, options::TimeLimits,
    problem::Problem, show::Show,
};
use crate::control::Control;

/// The service, and what the server has around it, for the requests of one listener. What can be used up is each
/// listener's own, so that clients of one never wait for those of another.
#[derive(Debug)]
pub(super) struct App {
    pub(super) control: Arc<dyn Control>,
    pub(super) lanes: Lanes,
    pub(super) auth: Arc<Auth>,
    pub(super) counts: Arc<Counts>,
    pub(super) limits: TimeLimits,
    pub(super) allowed_hosts: Vec<String>,
    pub(super) happenings: Arc<Happenings>,
    pub(super) show: Arc<Show>,
    /// The API's description of itself.
    pub(super) document: Bytes,
    /// Answers that go on for as long as the client likes: half of the listener's connections, so that
    /// requests get through.
    pub(super) streams: Arc<Semaphore>,
    /// Turns true when the server ends.
    pub(super) stopping: watch::Receiver<bool>,
}

/// What handlers are given.
pub(super) type Shared = Arc<App>;

/// Held by an answer that goes on.
pub(super) type StreamPlace = OwnedSemaphorePermit;

impl App {
    /// A place for an answer that goes on for as long as the client likes.
    ///
    /// # Errors
    /// 503 when there are too many.
    pub(super) fn stream_place(&self) -> Result<StreamPlace, Problem> {
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| {
            Problem::unavailable(
                "too many streams and downloads: close one, or try again in a second",
            )
        })
    }
}
