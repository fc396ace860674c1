//! What windows of takes in a store cost: `windows URL...` reads a second at several places of each take, opened anew each
//! time, and prints a table of requests and bytes as JSON Lines.

use std::error::Error;

use mocapd_store::{ObjectUrl, Store, StoredTake};
use mocapd_take::{motion::frame_at, traversal::Decode};
use serde::Serialize;

/// Windows of each take.
const WINDOWS: u64 = 25;

/// The cost of the windows of a take.
#[derive(Debug, Default, Serialize)]
struct WindowCosts {
    url: String,
    /// Whether it was opened from its end.
    from_end: bool,
    seconds: f64,
    markers: usize,
    take_bytes: u64,
    windows: u64,
    /// Most requests of a window, with those that open the take.
    requests_max: u64,
    /// Windows for which one range was not enough.
    second_ranges: u64,
    /// Bytes of all windows beside those that open the take.
    window_bytes: u64,
    /// Bytes of the stretches that the windows needed.
    needed_bytes: u64,
    /// Largest ratio of the two.
    ratio_max: f64,
}

fn costs(url: &ObjectUrl) -> Result<WindowCosts, Box<dyn Error>> {
    let store = Store::of(url)?.counted_anew();
    let opened = StoredTake::open(&store, url)?;
    let (n_rows, rate_hz) = (opened.map().n_rows, opened.map().header.rate_hz);
    let length = frame_at(std::time::Duration::from_secs(1), rate_hz).clamp(1, n_rows.max(1));
    let mut costs = WindowCosts {
        url: url.to_string(),
        from_end: opened.is_from_end(),
        seconds: n_rows as f64 / rate_hz,
        markers: opened.map().channels.len(),
        take_bytes: opened.reader().len_bytes(),
        ..WindowCosts::default()
    };
    for i in 0..WINDOWS {
        let start = (n_rows - length.min(n_rows)) * i / (WINDOWS - 1);
        let store = store.counted_anew();
        let mut take = StoredTake::open(&store, url)?;
        let opening = store.traffic();
        let mut needed = 0;
        take.read_rows(&(start..start + length), Decode::All, |take, _, _| {
            needed = take.bytes_read();
            Ok(())
        })?;
        let traffic = store.traffic();
        let read = traffic.received_bytes - opening.received_bytes;
        costs.windows += 1;
        costs.requests_max = costs.requests_max.max(traffic.requests);
        costs.second_ranges += u64::from(traffic.requests > opening.requests + 1);
        costs.window_bytes += read;
        costs.needed_bytes += needed;
        costs.ratio_max = costs.ratio_max.max(read as f64 / needed.max(1) as f64);
    }
    Ok(costs)
}

fn main() -> Result<(), Box<dyn Error>> {
    for url in std::env::args().skip(1) {
        let line = serde_json::to_string(&costs(&ObjectUrl::parse(&url)?)?)?;
        #[expect(clippy::print_stdout, reason = "the output of an example")]
        {
            println!("{line}");
        }
    }
    Ok(())
}
