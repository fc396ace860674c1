//! `verify --skeleton`: limb lengths and swapped labels, as JSON (docs/json.md) and as text.

use std::path::Path;

use anyhow::bail;
use mocapd::outcome::UsageError;
use mocapd_report::limbs::{Limb, LimbCheck, check};
use mocapd_take::motion::Motion;
use serde::Serialize;

use crate::cli::{
    motion_files::{TakeLimbs, limbs_of_take, read_take},
    output::plain,
    values::count,
};

/// Maximum number of ranges with an implausible limb length that the text lists; the JSON has all of them.
const OUTSIDE_SHOWN: usize = 20;

#[derive(Debug, Serialize)]
pub(super) struct LimbsReport {
    method: String,
    stature_mm: Option<f64>,
    bones: Vec<BoneReport>,
    bones_without_markers: Vec<String>,
    swaps: Vec<SwapReport>,
    outside: Vec<OutsideReport>,
}

#[derive(Debug, Serialize)]
struct BoneReport {
    name: String,
    markers: [String; 2],
    frames: u64,
    scan_mm: f64,
    uncertainty_mm: Option<f64>,
    median_mm: f64,
    ratio: f64,
    off: bool,
    spread_mm: f64,
    band_mm: [f64; 2],
    frames_outside: u64,
}

#[derive(Debug, Serialize)]
struct SwapReport {
    markers: [String; 2],
    #[serde(flatten)]
    when: FrameSpan,
    limbs: Vec<String>,
}

#[derive(Debug, Serialize)]
struct OutsideReport {
    bone: String,
    #[serde(flatten)]
    when: FrameSpan,
    extreme_mm: f64,
}

/// The first and the last frame of a range, and their times.
#[derive(Debug, Serialize)]
struct FrameSpan {
    from_frame: u64,
    to_frame: u64,
    from_s: f64,
    to_s: f64,
}

/// Measures the limbs of a take by the skeleton in a file, else by the take's own.
///
/// # Errors
/// If the take or the skeleton cannot be read, or no bone has markers at both ends; a usage error if there is no
/// skeleton.
pub(super) fn limbs_of(take: &Path, skeleton: Option<&Path>) -> anyhow::Result<LimbsReport> {
    let decoded = read_take(take)?;
    let Some(TakeLimbs { skeleton, limbs, columns }) = limbs_of_take(&decoded.motion, skeleton)?
    else {
        let message =
            format!("{} has no skeleton: give one with --skeleton skeleton.json", take.display());
        return Err(UsageError(message).into());
    };
    if limbs.is_empty() {
        bail!(
            "no bone of the skeleton has a marker at both ends: label markers by its joints, {}",
            skeleton.joints.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>().join(", ")
        );
    }
    let found = check(&decoded.motion, &limbs, &columns);
    let has_markers = |name: &str| limbs.iter().any(|limb| limb.bone.name == name);
    let without = skeleton.bones.iter().map(|bone| bone.name.clone());
    let mut report = LimbsReport::new(&decoded.motion, &limbs, &found);
    report.bones_without_markers = without.filter(|name| !has_markers(name)).collect();
    report.method = skeleton.method;
    report.stature_mm = skeleton.stature_mm;
    Ok(report)
}

impl LimbsReport {
    fn new(motion: &Motion, limbs: &[Limb], found: &LimbCheck) -> Self {
        let label = |column: usize| {
            motion.info.markers.get(column).map(|marker| marker.label.clone()).unwrap_or_default()
        };
        let name = |limb: usize| limbs.get(limb).map(|limb| limb.bone.name.clone());
        let rate_hz = motion.info.rate_hz;
        let when = |rows: &std::ops::Range<usize>| {
            let (from, to) = (rows.start, rows.end.saturating_sub(1));
            let seconds = |row: usize| (row as f64 / rate_hz * 1e6).round() * 1e-6;
            let (from_s, to_s) = (seconds(from), seconds(to));
            FrameSpan { from_frame: from as u64, to_frame: to as u64, from_s, to_s }
        };
        let bone = |(limb, of): (&Limb, &mocapd_report::limbs::LimbStats)| BoneReport {
            name: limb.bone.name.clone(),
            markers: limb.ends.map(label),
            frames: of.frames,
            scan_mm: limb.bone.length_mm,
            uncertainty_mm: limb.bone.uncertainty_mm,
            median_mm: of.median_mm,
            ratio: of.median_mm / limb.bone.length_mm,
            off: of.frames > 0 && limb.is_off(of.median_mm),
            spread_mm: of.spread_mm,
            band_mm: [of.band_middle_mm - of.band_half_mm, of.band_middle_mm + of.band_half_mm],
            frames_outside: of.frames_outside,
        };
        let swap = |swap: &mocapd_report::limbs::Swap| SwapReport {
            markers: swap.markers.map(label),
            when: when(&swap.rows),
            limbs: swap.limbs.iter().filter_map(|&limb| name(limb)).collect(),
        };
        let outside = |outside: &mocapd_report::limbs::Excursion| OutsideReport {
            bone: name(outside.limb).unwrap_or_default(),
            when: when(&outside.rows),
            extreme_mm: outside.extreme_mm,
        };
        Self {
            method: String::new(),
            stature_mm: None,
            bones: limbs.iter().zip(&found.lengths).map(bone).collect(),
            bones_without_markers: Vec::new(),
            swaps: found.swaps.iter().map(swap).collect(),
            outside: found.outside.iter().map(outside).collect(),
        }
    }

    /// What contradicts the skeleton, as text for people: swapped labels, and bones that do not fit the take.
    pub(super) fn contradictions(&self) -> Vec<String> {
        let mut found = Vec::new();
        if !self.swaps.is_empty() {
            found.push(format!("labels are swapped {}", count(self.swaps.len() as u64, "time")));
        }
        let names = |is_listed: &dyn Fn(&BoneReport) -> bool| {
            let listed = self.bones.iter().filter(|bone| is_listed(bone));
            listed.map(|bone| bone.name.as_str()).collect::<Vec<_>>()
        };
        let off = names(&|bone| bone.off);
        if !off.is_empty() {
            let all = self.bones.len();
            found.push(format!(
                "{} of {all} bones do not fit (other lengths in the take than in the skeleton): {}",
                off.len(),
                off.join(", ")
            ));
        }
        let unsteady = names(&|bone| self.outside.iter().any(|outside| outside.bone == bone.name));
        if !unsteady.is_empty() {
            found.push(format!(
                "implausible lengths without a swap of labels, {}: {}",
                count(self.outside.len() as u64, "time"),
                unsteady.join(", ")
            ));
        }
        found
    }

    /// A table of the limbs, and the swapped labels.
    pub(super) fn text(&self) -> String {
        let mut out = format!(
            "limb lengths in the take and in the scan (mm):\n{:<20} {:>9} {:>8} {:>12} {:>7} {:>7} {:>16} {:>8}\n",
            "bone", "frames", "median", "scan", "ratio", "spread", "plausible", "outside"
        );
        for bone in &self.bones {
            let uncertainty =
                bone.uncertainty_mm.map_or_else(String::new, |mm| format!(" +- {mm:.0}"));
            let scan = format!("{:.0}{uncertainty}", bone.scan_mm);
            let band = format!("{:.0} to {:.0}", bone.band_mm[0], bone.band_mm[1]);
            let note = if bone.off { "  DIFFERS from the scan" } else { "" };
            out += &format!(
                "{:<20} {:>9} {:>8.1} {scan:>12} {:>7.3} {:>7.1} {band:>16} {:>8}{note}\n",
                plain(&bone.name),
                bone.frames,
                bone.median_mm,
                bone.ratio,
                bone.spread_mm,
                bone.frames_outside
            );
        }
        if !self.bones_without_markers.is_empty() {
            let names = self.bones_without_markers.join(", ");
            out += &format!("without a marker at both ends: {}\n", plain(&names));
        }
        for SwapReport { markers: [a, b], when, limbs } in &self.swaps {
            let (a, b, when, limbs) = (plain(a), plain(b), when.text(), limbs.join(", "));
            let limbs = plain(&limbs);
            out +=
                &format!("SWAPPED: {a} and {b}, {when}: exchanging the labels corrects {limbs}\n");
        }
        if self.swaps.is_empty() {
            out += "no swapped labels found\n";
        }
        for OutsideReport { bone, when, extreme_mm } in self.outside.iter().take(OUTSIDE_SHOWN) {
            let (bone, when) = (plain(bone), when.text());
            out += &format!(
                "implausible length without a swap of labels: {bone}, {when}, extreme {extreme_mm:.0} mm\n"
            );
        }
        if let Some(more) = self.outside.len().checked_sub(OUTSIDE_SHOWN).filter(|&more| more > 0) {
            out += &format!("and {more} more: see --json\n");
        }
        out
    }
}

impl FrameSpan {
    fn text(&self) -> String {
        let Self { from_frame, to_frame, from_s, to_s } = self;
        format!("{from_s:.3} s to {to_s:.3} s (frames {from_frame} to {to_frame}, from 0)")
    }
}
