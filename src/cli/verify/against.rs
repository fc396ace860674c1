//! `verify --against`: a take compared with its original, and with `--cutoff` its velocities and accelerations with
//! theirs, or a recording with the log of a simulated device, as JSON (docs/json.md) and as text.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    sync::Arc,
};

use anyhow::{Context, bail};
use mocapd::outcome::UsageError;
use mocapd_acquire::files::{self, SparseFile};
use mocapd_report::{
    ReportError,
    derivative::{DerivativeError, by_marker},
};
use mocapd_take::{
    TakeFrames,
    compare::{
        AnalogDifference, BodyDifference, ChannelDifference, Difference, PoseDifference,
        SampledDifference, SentAccount, SentComparison, SentLog, compare, compare_analog,
        compare_log, compare_poses, compare_samples,
    },
    damage::Problem,
    foreign::analog::is_needed,
    interchange::ReadOptions,
    motion::{Ambiguity, FrameSource, MotionInfo},
};
use serde::Serialize;

use crate::cli::{
    motion_files::{MotionSource, open_motion, read_options, read_original, read_take},
    output::plain,
    paths, remote,
    values::{count, count_of, thousands},
};

/// Maximum number of labels that the text lists; the JSON has all of them.
const LABELS_LISTED_MAX: usize = 10;

#[derive(Debug, Serialize)]
pub(crate) struct AgainstReport {
    within_tolerance: bool,
    /// Ambiguities in the original: places that could also be read in another way.
    ambiguities: Vec<AmbiguityReport>,
    /// The analog samples; `None` unless both have some.
    analog: Option<AnalogDifference>,
    /// The sampled channels of recordings; `None` if there are none to compare.
    sampled: Option<SampledDifference>,
    /// The poses of rigid bodies; `None` if there are none to compare.
    poses: Option<PoseDifference>,
    #[serde(flatten)]
    difference: Difference,
}

#[derive(Debug, Serialize)]
struct AmbiguityReport {
    kind: &'static str,
    #[serde(rename = "words")]
    text: String,
}

impl From<&Ambiguity> for AmbiguityReport {
    fn from(found: &Ambiguity) -> Self {
        Self { kind: found.kind(), text: found.to_string() }
    }
}

/// Compares a take with a motion file or another take.
///
/// # Errors
/// If one of the two cannot be read, or they have no frame in common.
pub(crate) fn against(
    take: &Path,
    original: &Path,
    tolerance_mm: f64,
) -> anyhow::Result<AgainstReport> {
    let open = |path: &Path| {
        let file = BufReader::new(remote::open(path)?);
        TakeFrames::open_with(file, is_needed, files::scratch)
            .with_context(|| format!("cannot read {}", path.display()))
    };
    let comparing = || format!("cannot compare {} with {}", take.display(), original.display());
    let take_frames = open(take)?;
    let take_info = take_frames.info().clone();
    // Without parameters no sample is lost.
    let is_damaged =
        take_frames.problems().iter().any(|problem| *problem != Problem::ParametersLost);
    let analog_of = |original: &MotionInfo| {
        compare_analog(&take_info, original, is_damaged).with_context(comparing)
    };
    let cut_off = !take_frames.map().finished;
    let (mut ambiguities, mut notes) = (Vec::new(), Vec::new());
    let (mut sampled, mut poses) = (None, None);
    let (difference, exact, analog) = if paths::is_take(original) {
        let (original_path, original) = (original, open(original)?);
        let exact = original.map().header.tolerance_mm == 0.0;
        let analog = analog_of(original.info())?;
        let mut files = [open_file(take)?, open_file(original_path)?];
        let [ours, theirs] = &mut files;
        let maps = [take_frames.map(), original.map()];
        sampled = compare_samples((maps[0], ours), (maps[1], theirs)).with_context(comparing)?;
        poses = compare_poses((maps[0], ours), (maps[1], theirs)).with_context(comparing)?;
        (compare(take_frames, original), exact, analog)
    } else {
        let options = read_options(&take_frames);
        let source = MotionSource::file(original)?;
        let motion = open_motion(&source, &options, true, &Arc::default())?;
        ambiguities.extend(motion.info().source.ambiguities.iter().map(AmbiguityReport::from));
        notes.extend(note_of(&options));
        let analog = analog_of(motion.info())?;
        (compare(take_frames, motion), true, analog)
    };
    let mut difference = difference.with_context(comparing)?;
    if cut_off {
        // The frames after the cut-off are lost; that is not a difference.
        difference.frames_lost += difference.frames_after_take;
        difference.frames_missing -= difference.frames_after_take;
    }
    if !exact {
        // The original has an error of its own, which the take's blocks do not state.
        difference.beyond_stated = None;
    }
    notes.append(&mut difference.notes);
    difference.notes = notes;
    let report = AgainstReport::new(difference, tolerance_mm);
    let is_rest_within = analog.as_ref().is_none_or(AnalogDifference::is_within)
        && sampled.as_ref().is_none_or(SampledDifference::is_within)
        && poses.as_ref().is_none_or(PoseDifference::is_within);
    let within_tolerance = report.within_tolerance && is_rest_within;
    Ok(AgainstReport { within_tolerance, ambiguities, analog, sampled, poses, ..report })
}

/// How a recording accounts for what a simulated device sent.
#[derive(Debug, Serialize)]
pub(super) struct SentReport {
    /// What the log has rows of.
    log: &'static str,
    complete: bool,
    #[serde(flatten)]
    found: SentComparison,
}

/// The log of a simulated device; `None` if the file is another one.
///
/// # Errors
/// If it cannot be read.
pub(super) fn sent_log(path: &Path) -> anyhow::Result<Option<SentLog>> {
    if !paths::ends_in(path, "csv") {
        return Ok(None);
    }
    let mut file = open_file(path)?;
    let reading = || format!("cannot read {}", path.display());
    if !SentLog::is_one(file.fill_buf().with_context(reading)?) {
        return Ok(None);
    }
    Ok(Some(SentLog::read(file).with_context(reading)?))
}

impl SentReport {
    /// Compares a take with the log of the device.
    ///
    /// # Errors
    /// If the take cannot be read; a usage error for one that is no recording.
    pub(super) fn new(take: &Path, log: &SentLog) -> anyhow::Result<Self> {
        let reading = || format!("cannot read {}", take.display());
        let frames = TakeFrames::open(open_file(take)?).with_context(reading)?;
        if frames.map().header.device.is_none() {
            bail!(UsageError(format!(
                "{} is no recording: the log of a device is for takes of it",
                take.display()
            )));
        }
        let found = compare_log(frames.map(), open_file(take)?, log).with_context(reading)?;
        let of = if log.is_of_frames() { "frames" } else { "batches" };
        Ok(Self { log: of, complete: found.is_complete(), found })
    }

    pub(super) fn is_complete(&self) -> bool {
        self.complete
    }

    /// The end of a line about the take.
    pub(super) fn short(&self) -> String {
        let verdict = if self.complete { "accounts for" } else { "DOES NOT ACCOUNT for" };
        format!("; {verdict} the {} that the device sent", self.log)
    }

    /// A line for the frames or for each group, and one for each kind of difference.
    pub(super) fn text(&self) -> String {
        let mut out = String::new();
        for account in &self.found.accounts {
            out += &account_text(account);
        }
        if self.found.is_of_another() {
            out += "  NO TIME IN COMMON: give the log of this recording; an NDI system without BX2 sends no times, so its \
                    log cannot be compared\n";
        }
        for group in &self.found.groups_missing {
            out += &format!("  in only one of take and log: group {group} of sampled channels\n");
        }
        out
    }
}

/// From this number on groups have poses: no device gives it.
const POSE_GROUPS: u32 = 16;

fn account_text(account: &SentAccount) -> String {
    let what = match account.group {
        None => "frames".to_owned(),
        Some(group) if group >= POSE_GROUPS => format!("frames with poses of group {group}"),
        Some(group) => format!("samples of group {group}"),
    };
    let counted = [
        (account.dropped, "dropped by the device"),
        (account.lost, "did not arrive"),
        (account.arrived_lost, "arrived, but the take states them as lost"),
        (account.outside, "sent before or after those of the take"),
    ];
    let (sent, recorded) = (thousands(account.sent), thousands(account.recorded));
    let mut out =
        format!("against the log of the device: {sent} {what} sent, {recorded} in the take");
    for (n, which) in counted.iter().filter(|(n, _)| *n > 0) {
        out += &format!(", {} {which}", thousands(*n));
    }
    out.push('\n');
    for (n, which) in [
        (account.unknown, "in the take, but NOT SENT, or not whole"),
        (account.unaccounted, "NEITHER in the take nor stated as lost"),
        (account.times_unknown, "at times that the log DOES NOT HAVE"),
    ] {
        if n > 0 {
            out += &format!("  {which}: {} {what}\n", thousands(n));
        }
    }
    out
}

/// The file of a take.
fn open_file(path: &Path) -> anyhow::Result<BufReader<SparseFile>> {
    Ok(BufReader::new(remote::open(path)?))
}

/// The note that the original was read with the options of the import, if there were any.
fn note_of(options: &ReadOptions) -> Option<String> {
    let options: Vec<String> =
        options.settings().iter().map(|(name, value)| format!("--{name} {value}")).collect();
    (!options.is_empty())
        .then(|| format!("the original was read with the import's options: {}", options.join(" ")))
}

impl AgainstReport {
    pub(crate) fn new(difference: Difference, tolerance_mm: f64) -> Self {
        let within_tolerance = difference.is_within(tolerance_mm);
        let (analog, sampled, poses) = (None, None, None);
        Self { within_tolerance, ambiguities: Vec::new(), analog, sampled, poses, difference }
    }

    /// Whether the take agrees with the original within the tolerance.
    pub(crate) fn is_within(&self) -> bool {
        self.within_tolerance
    }

    /// The end of a line about the take: the largest error.
    pub(super) fn short(&self) -> String {
        let verdict = if self.is_within() { "agrees with" } else { "DIFFERS from" };
        format!("; {verdict} the original, max error {:.4} mm", self.difference.max_error_mm)
    }

    /// A line with the errors, and a line for each other kind of difference.
    pub(crate) fn text(&self, tolerance_mm: f64) -> String {
        let found = &self.difference;
        let verdict = match (tolerance_mm > 0.0, found.max_error_mm <= tolerance_mm) {
            (true, true) => format!("within the tolerance of {tolerance_mm} mm"),
            (true, false) => format!("NOT WITHIN the tolerance of {tolerance_mm} mm"),
            (false, _) => format!("{} not bit-identical", count(found.bits_differing, "sample")),
        };
        let (samples, frames) = (count(found.samples, "sample"), count(found.frames, "frame"));
        let (max_mm, rms_mm) = (found.max_error_mm, found.rms_error_mm);
        let mut out = format!(
            "against the original: {samples} of {frames}, max error {max_mm:.4} mm, rms {rms_mm:.4} mm, {verdict}\n"
        );
        for note in &found.notes {
            out += &format!("  {}\n", plain(note));
        }
        for ambiguity in &self.ambiguities {
            let text = plain(&ambiguity.text);
            out += &format!("  the original is ambiguous; it was read as in the import: {text}\n");
        }
        out += &self.analog.as_ref().map(analog_text).unwrap_or_default();
        out += &self.sampled.as_ref().map(sampled_text).unwrap_or_default();
        out += &self.poses.as_ref().map(poses_text).unwrap_or_default();
        if found.frames_lost > 0 {
            let frames = count(found.frames_lost, "frame");
            out += &format!("  not compared, lost in the take: {frames}\n");
        }
        if let Some(beyond) = found.beyond_stated.filter(|&beyond| beyond > 0) {
            let samples = count(beyond, "sample");
            out += &format!("  ERROR ABOVE the one that the block states: {samples}\n");
        }
        if found.frames_missing > 0 {
            out += &format!("  in only one of the two: {}\n", count(found.frames_missing, "frame"));
        }
        if found.gaps_differing > 0 {
            let samples = count(found.gaps_differing, "sample");
            out += &format!("  a gap in only one of the two: {samples}\n");
        }
        if !found.labels_differing.is_empty() {
            let listed = found.labels_differing.len().min(LABELS_LISTED_MAX);
            let labels = found.labels_differing[..listed].join(", ");
            let more = match found.labels_differing.len() - listed {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            out += &format!("  labels differ: {}{more}\n", plain(&labels));
        }
        out
    }
}

/// A line about the samples of recordings, and one for each kind of difference.
fn sampled_text(found: &SampledDifference) -> String {
    let SampledDifference {
        samples,
        samples_differing,
        samples_lost,
        samples_missing,
        groups_missing,
        residual_groups_skipped,
    } = *found;
    let mut out = match samples_differing {
        0 => format!("  {} of sampled channels, all exact\n", count(samples, "sample")),
        n => format!(
            "  {} of sampled channels, {} DIFFERENT\n",
            count(samples, "sample"),
            thousands(n)
        ),
    };
    if samples_lost > 0 {
        let samples = count(samples_lost, "sample");
        out += &format!("  not compared, lost in the take: {samples} of sampled channels\n");
    }
    if samples_missing > 0 {
        let samples = count(samples_missing, "sample");
        out += &format!("  in only one of the two: {samples} of sampled channels\n");
    }
    if groups_missing > 0 {
        let groups = count(groups_missing as u64, "group");
        out += &format!("  in only one of the two: {groups} of sampled channels\n");
    }
    if residual_groups_skipped > 0 {
        out += "  not compared, in only one of the two: residuals of markers\n";
    }
    out
}

/// A line about the poses of rigid bodies, one for each body with an error, and one for each kind of difference.
fn poses_text(found: &PoseDifference) -> String {
    let poses = count(found.poses, "pose");
    let mut out = match (found.poses_differing, found.beyond_stated) {
        (0, _) => format!("  {poses} of rigid bodies, all exact\n"),
        (n, 0) => format!(
            "  {poses} of rigid bodies, {} not bit-identical, within the errors that the takes state\n",
            thousands(n)
        ),
        (_, n) => format!(
            "  {poses} of rigid bodies, {} NOT WITHIN the errors that the takes state\n",
            thousands(n)
        ),
    };
    let differs = |of: &&BodyDifference| of.max_error_mm > 0.0 || of.max_error_degrees > 0.0;
    for body in found.bodies.iter().filter(differs) {
        out += &format!(
            "    {}: max error {:.4} mm, stated {:.4}, and {:.4} degrees, stated {:.4}\n",
            plain(&body.name),
            body.max_error_mm,
            body.stated_max_error_mm,
            body.max_error_degrees,
            body.stated_max_error_degrees
        );
    }
    if found.states_differing > 0 {
        let poses = count(found.states_differing, "pose");
        out += &format!("  of a body tracked in only one of the two, or lost otherwise: {poses}\n");
    }
    if found.poses_lost > 0 {
        let poses = count(found.poses_lost, "pose");
        out += &format!("  not compared, lost in the take: {poses} of rigid bodies\n");
    }
    if found.poses_missing > 0 {
        let poses = count(found.poses_missing, "pose");
        out += &format!("  in only one of the two: {poses} of rigid bodies\n");
    }
    if found.bodies_missing > 0 {
        let bodies = count_of(found.bodies_missing as u64, ["rigid body", "rigid bodies"]);
        out += &format!("  in only one of the two: {bodies}\n");
    }
    out
}

/// A line about the analog samples, and one for each channel with an error.
fn analog_text(found: &AnalogDifference) -> String {
    let samples = count(found.samples, "analog sample");
    let mut out = match found.samples_differing {
        0 => format!("  {samples}, all exact\n"),
        n => format!("  {samples}, {} replaced within the tolerance\n", thousands(n)),
    };
    let with_error = found.channels.iter().filter(|channel| channel.max_error > 0.0);
    for ChannelDifference { name, unit, stated_max_error, max_error } in with_error {
        let (name, unit) = (plain(name), plain(unit));
        out += &format!(
            "    {name}: max error {max_error:.3e} {unit}, stated {stated_max_error:.3e} {unit}\n"
        );
    }
    if found.samples_lost > 0 {
        let samples = count(found.samples_lost, "analog sample");
        out += &format!("  not compared, lost in the take: {samples}\n");
    }
    if found.beyond_stated > 0 {
        let samples = count(found.beyond_stated, "analog sample");
        out += &format!("  ERROR ABOVE the one that the channel states: {samples}\n");
    }
    if found.channels_missing > 0 {
        let channels = count(found.channels_missing as u64, "analog channel");
        out += &format!("  in only one of the two: {channels}\n");
    }
    out
}

#[derive(Debug, Serialize)]
pub(super) struct DerivativesReport {
    cutoff_hz: f64,
    samples_left_out: u64,
    all: Errors,
    markers: Vec<MarkerErrors>,
}

#[derive(Debug, Serialize)]
struct MarkerErrors {
    label: String,
    #[serde(flatten)]
    errors: Errors,
}

#[derive(Debug, Serialize)]
struct Errors {
    velocity_rms_mm_s: f64,
    velocity_max_mm_s: f64,
    acceleration_rms_mm_s2: f64,
    acceleration_max_mm_s2: f64,
    original_velocity_rms_mm_s: f64,
    original_velocity_max_mm_s: f64,
    original_acceleration_rms_mm_s2: f64,
    original_acceleration_max_mm_s2: f64,
}

impl From<&DerivativeError> for Errors {
    fn from(found: &DerivativeError) -> Self {
        Self {
            velocity_rms_mm_s: found.velocity_mm_s.rms(),
            velocity_max_mm_s: found.velocity_mm_s.max(),
            acceleration_rms_mm_s2: found.acceleration_mm_s2.rms(),
            acceleration_max_mm_s2: found.acceleration_mm_s2.max(),
            original_velocity_rms_mm_s: found.original_velocity_mm_s.rms(),
            original_velocity_max_mm_s: found.original_velocity_mm_s.max(),
            original_acceleration_rms_mm_s2: found.original_acceleration_mm_s2.rms(),
            original_acceleration_max_mm_s2: found.original_acceleration_mm_s2.max(),
        }
    }
}

/// Compares the derivatives of a take with those of its original.
///
/// # Errors
/// If one cannot be read; a usage error for a cutoff that the frame rate does not allow.
pub(super) fn derivatives(
    take: &Path,
    original: &Path,
    cutoff_hz: f64,
) -> anyhow::Result<DerivativesReport> {
    let decoded = read_take(take)?;
    let (original, _) = read_original(take, original)?;
    let found = by_marker(&decoded.motion, &original, cutoff_hz).map_err(|error| match error {
        ReportError::InvalidArgument(why) => UsageError(why).into(),
        other => anyhow::Error::from(other),
    })?;
    let mut all = DerivativeError::default();
    found.iter().for_each(|marker| all.add_all(marker));
    let markers = original.info.markers.iter().zip(&found).map(|(marker, found)| MarkerErrors {
        label: marker.label.clone(),
        errors: Errors::from(found),
    });
    Ok(DerivativesReport {
        cutoff_hz,
        samples_left_out: all.samples_left_out,
        all: Errors::from(&all),
        markers: markers.collect(),
    })
}

impl DerivativesReport {
    /// A table of the markers, with all of them together in the last line.
    pub(super) fn text(&self) -> String {
        let mut out = format!(
            "errors of the take's derivatives, low-passed at {} Hz (fourth-order zero-lag Butterworth):\n\
             {:<20} {:>22} {:>26}\n{:<20} {:>10} {:>11} {:>13} {:>12}\n",
            self.cutoff_hz,
            "",
            "velocity (mm/s)",
            "acceleration (mm/s^2)",
            "marker",
            "rms",
            "largest",
            "rms",
            "largest"
        );
        let line = |label: &str, errors: &Errors| {
            format!(
                "{:<20} {:>10.3} {:>11.3} {:>13.2} {:>12.2}\n",
                plain(label),
                errors.velocity_rms_mm_s,
                errors.velocity_max_mm_s,
                errors.acceleration_rms_mm_s2,
                errors.acceleration_max_mm_s2
            )
        };
        for marker in &self.markers {
            out += &line(&marker.label, &marker.errors);
        }
        out += &line("all", &self.all);
        let own = &self.all;
        out += &format!(
            "the original motion: velocity {:.0} mm/s rms, {:.0} at most; acceleration {:.0} mm/s^2 rms, {:.0} at most\n",
            own.original_velocity_rms_mm_s,
            own.original_velocity_max_mm_s,
            own.original_acceleration_rms_mm_s2,
            own.original_acceleration_max_mm_s2
        );
        if self.samples_left_out > 0 {
            out += &format!(
                "left out: {} samples, in gap-free runs shorter than a period of the cutoff\n",
                self.samples_left_out
            );
        }
        out
    }
}
