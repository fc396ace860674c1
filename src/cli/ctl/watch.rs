//! `status --watch`.

use std::{sync::atomic::Ordering, time::Duration};

use mocapd::outcome::Outcome;
use mocapd_service::status::Status;

use super::{client::Client, orders::read, words};
use crate::cli::{
    output::{print, print_json_text},
    stop::stop_on_signal,
};

const EVERY: Duration = Duration::from_secs(1);

/// Between looks whether it was Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// A line every second.
pub(super) fn run(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let stop = stop_on_signal()?;
    loop {
        let document = client.get("/v1/status")?;
        if json {
            print_json_text(&document.to_string())?;
        } else {
            let status: Status = read(&document)?;
            print(&format!("{}\n", words::watched(&status)))?;
        }
        for _ in 0..EVERY.as_millis() / LOOK.as_millis() {
            if stop.load(Ordering::Relaxed) {
                return Ok(Outcome::Done);
            }
            std::thread::sleep(LOOK);
        }
    }
}
