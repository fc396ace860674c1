//! What is said at the end.

use mocapd_simulator::device::SentLog;

use super::Spoken;

/// Of a log, which has bytes and knows no frames.
pub(super) fn of_log(sent: &SentLog) -> String {
    format!("{}: {} bytes of the log sent", runs(sent), sent.bytes_sent)
}

fn runs(sent: &SentLog) -> String {
    let starts = sent.starts;
    format!("{starts} {}", if starts == 1 { "run" } else { "runs" })
}

/// The account, and what faults did of it, on a line of its own: what was produced is what comes after it.
pub(super) fn of_motion(sent: &SentLog, spoken: Spoken) -> String {
    let SentLog { total, frames_sent, bytes_sent, .. } = sent;
    let runs = runs(sent);
    let why = match spoken {
        Spoken::Dvmc => "its queue was full",
        Spoken::Ndi => "not fetched before the next",
    };
    let mut said = format!(
        "{runs}: {} frames produced, {frames_sent} sent in {bytes_sent} bytes, {} dropped by the device \
         ({why}), {} never taken",
        total.frames_produced,
        total.frames_dropped,
        sent.frames_waiting + sent.frames_discarded
    );
    if spoken == Spoken::Ndi {
        let unasked = total.frames_unasked;
        said.push_str(&format!(", {unasked} after the last request (on no recorder's account)"));
    }
    if let Some(faults) = &sent.faults {
        said = format!("{said}\n{}", faults.words());
    }
    said
}
