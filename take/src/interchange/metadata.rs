//! The key-value metadata of Parquet and MCAP files (`docs/columns.md`).

use serde_json::json;

use crate::{motion::FrameSource, record::Ledger};

/// Keys and values that describe the trajectories and, if they come from one, the take. Lists and records are JSON.
pub(super) fn metadata(frames: &dyn FrameSource) -> Vec<(String, String)> {
    let info = frames.info();
    let labels: Vec<&str> = info.markers.iter().map(|marker| &*marker.label).collect();
    let mut all = vec![
        ("rate_hz", info.rate_hz.to_string()),
        ("frames", info.n_frames.to_string()),
        ("first_frame", info.source.first_frame.to_string()),
        ("labels", json!(labels).to_string()),
        ("up_axis", info.up.name().unwrap_or("unknown").to_owned()),
    ];
    if let Some(take) = frames.take() {
        let header = &take.header;
        all.push(("software", header.software.clone()));
        all.push(("take_id", header.take_id_text()));
        all.push(("created_unix_ms", header.created_unix_ms.to_string()));
        all.push(("resampler", header.resampler.clone()));
        all.push(("tolerance_mm", header.tolerance_mm.to_string()));
        all.push(("finished", take.finished.to_string()));
        let problems: Vec<String> = take.problems.iter().map(ToString::to_string).collect();
        all.push(("problems", json!(problems).to_string()));
        if let Some(device) = &header.device {
            let device = json!({ "model": device.model, "serial": device.serial });
            all.push(("device", device.to_string()));
        }
        if let Some(found) = &take.ledger {
            all.push(("ledger", ledger(found).to_string()));
        }
    }
    all.into_iter().map(|(name, value)| (format!("mocapd.{name}"), value)).collect()
}

/// The counters of the whole take under the names of `info --json`.
fn ledger(ledger: &Ledger) -> serde_json::Value {
    json!({
        "frames_sent": ledger.frames_sent,
        "recorded": ledger.recorded,
        "lost_on_link": ledger.lost_on_link,
        "dropped_by_device": ledger.dropped_by_device,
        "lost_ring_full": ledger.lost_ring_full,
        "lost_other": ledger.lost_other,
        "duplicates": ledger.duplicates,
        "unknown_after_disconnect": ledger.unknown_after_disconnect,
        "samples_announced": ledger.samples_announced,
        "samples_present": ledger.samples_present,
        "samples_occluded": ledger.samples_occluded,
        "contradictions": ledger.contradictions,
        "closes": ledger.closes(),
    })
}
