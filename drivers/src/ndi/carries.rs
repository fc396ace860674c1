//! What the line carries, and what to do where that is too little.

use super::{bauds::BAUDS, bx, gbf, host::NdiHost};
use crate::{device::LinkBudget, link::link_budget};

/// Bytes of a binary answer around its block.
const AROUND_BYTES: usize = 6 + 2;

impl NdiHost {
    /// What the tools need, before any stray was seen.
    pub(super) fn budget(&self) -> LinkBudget {
        let bytes = self.answer_bytes(0);
        link_budget(
            bytes,
            self.hello.rate_mhz,
            self.hello.rate_max_mhz,
            line_bytes_per_s(self.baud),
        )
    }

    fn answer_bytes(&self, strays: usize) -> usize {
        let tools = self.table.len();
        AROUND_BYTES
            + if self.bx2 {
                gbf::block_bytes(tools, strays)
            } else {
                bx::block_bytes(tools, strays)
            }
    }

    /// A poll and its answer take turns on the line, so both count.
    fn bytes_a_frame(&self, strays: usize) -> u64 {
        (self.poll.as_bytes().len() + self.answer_bytes(strays)) as u64
    }

    /// Why a start is refused, and what to do.
    pub(super) fn refusal(&self) -> String {
        let needed = self.budget().needed_bytes_per_s;
        format!("the line is too slow for the NDI system: {}", self.limits(0, needed))
    }

    /// Words for a line that does not carry every frame with what was just seen; said once a run.
    pub(super) fn too_slow(&mut self) -> Option<String> {
        let strays = self.seen.strays.len() + self.seen.strays_beyond;
        let needed = self.needed_bytes_per_s(strays);
        if needed <= line_bytes_per_s(self.baud) || !self.run.says_slow() {
            return None;
        }
        Some(format!(
            "the line is too slow for every frame of the NDI system: {}. The frames that are not fetched in \
             time count as dropped by the device, and strays may change their numbers",
            self.limits(strays, needed)
        ))
    }

    fn needed_bytes_per_s(&self, strays: usize) -> u64 {
        (self.bytes_a_frame(strays) * u64::from(self.hello.rate_mhz)).div_ceil(1000)
    }

    fn limits(&self, strays: usize, needed: u64) -> String {
        let tools = self.table.len();
        let most_hz = line_bytes_per_s(self.baud) as f64 / self.bytes_a_frame(strays) as f64;
        let rate_hz = f64::from(self.hello.rate_mhz) / 1000.0;
        let needed = needed.max(self.needed_bytes_per_s(strays));
        let enough = BAUDS.iter().find(|(baud, _)| line_bytes_per_s(*baud) >= needed);
        let advice = match enough {
            Some((baud, _)) if self.baud >= BAUDS[self.asked_for].0 => {
                format!("write @{baud} behind the port in the device's URI")
            }
            Some(_) => {
                "system or line take no higher speed: use another adapter, show it fewer markers, or lower its \
                 frame rate"
                    .to_owned()
            }
            None => "no speed is enough: show it fewer markers, or lower its frame rate".to_owned(),
        };
        let seen = [(tools, "tool"), (strays, "stray marker")];
        let seen: Vec<_> =
            seen.iter().filter(|(n, _)| *n > 0).map(|(n, what)| counted(*n, what)).collect();
        let seen = if seen.is_empty() { "frames".to_owned() } else { seen.join(" and ") };
        format!(
            "{seen} over {} baud come at most {most_hz:.1} times a second, and it runs at {rate_hz} Hz; {advice}",
            self.baud
        )
    }
}

/// Ten bits a byte: start, eight of data, stop.
fn line_bytes_per_s(baud: u32) -> u64 {
    u64::from(baud) / 10
}

fn counted(n: usize, what: &str) -> String {
    let plural = if n == 1 { "" } else { "s" };
    format!("{n} {what}{plural}")
}
