//! The XML of heads and feet, after the metadata that the format's wiki gives for motion capture.

use std::fmt::Write;

use crate::interchange::text::column_labels;
use crate::motion::MotionInfo;

/// A text as XML: marks escaped, and what XML cannot hold replaced.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\t' | '\n' | '\r' => out.push(' '),
            '\0'..'\x20' | '\u{fffe}' | '\u{ffff}' => out.push(char::REPLACEMENT_CHARACTER),
            other => out.push(other),
        }
    }
    out
}

/// The markers' stream: a channel a coordinate.
pub(super) fn motion_head(info: &MotionInfo) -> String {
    let labels: Vec<String> = column_labels(info).iter().map(|label| escaped(label)).collect();
    let mut head = format!(
        "<?xml version=\"1.0\"?><info><name>mocapd</name><type>MoCap</type><channel_count>{}</channel_count>\
         <nominal_srate>{}</nominal_srate><channel_format>float32</channel_format><source_id>mocapd</source_id>\
         <version>1.1</version><created_at>0</created_at><desc><channels>",
        3 * labels.len(),
        info.rate_hz
    );
    for label in &labels {
        for axis in ["X", "Y", "Z"] {
            let name = axis.to_ascii_lowercase();
            write!(
                head,
                "<channel><label>{label}.{name}</label><marker>{label}</marker><type>Position{axis}</type>\
                 <unit>millimeters</unit></channel>"
            )
            .unwrap_or_default();
        }
    }
    head.push_str("</channels><setup><name>mocapd</name><markers>");
    for label in &labels {
        write!(head, "<marker><label>{label}</label></marker>").unwrap_or_default();
    }
    head.push_str("</markers></setup></desc></info>");
    head
}

/// The stream of what happened: one text a sample, at uneven times.
pub(super) fn event_head() -> String {
    "<?xml version=\"1.0\"?><info><name>mocapd events</name><type>Markers</type><channel_count>1</channel_count>\
     <nominal_srate>0</nominal_srate><channel_format>string</channel_format><source_id>mocapd events</source_id>\
     <version>1.1</version><created_at>0</created_at><desc><channels><channel><label>event</label></channel>\
     </channels></desc></info>"
        .to_owned()
}

/// What closes a stream.
pub(super) fn foot(first_s: f64, last_s: f64, n: u64, rate_hz: Option<f64>) -> String {
    let rate =
        rate_hz.map_or_else(String::new, |hz| format!("<measured_srate>{hz}</measured_srate>"));
    format!(
        "<?xml version=\"1.0\"?><info><first_timestamp>{first_s}</first_timestamp><last_timestamp>{last_s}\
         </last_timestamp><sample_count>{n}</sample_count>{rate}<clock_offsets><offset><time>0</time><value>0</value></offset></clock_offsets></info>"
    )
}
