//! The EVENT group, which holds the events of a trial, and the ROTATION group with its data section, which hold the poses
//! of rigid bodies.
//!
//! The parameters of EVENT have one element for each event: texts in CONTEXTS, LABELS, DESCRIPTIONS and SUBJECTS, minutes
//! and seconds in TIMES, integers in `ICON_IDS` and bytes in `GENERIC_FLAGS`. Times count from frame number 1, not from the
//! first frame of the file, as in Vicon's software and BTK.
//!
//! The section of poses, as C-Motion introduced it in 2019 and ezc3d, `Visual3D` and others read it, has 17 floats for each
//! body in each frame: a 4 x 4 matrix, column after column, that takes points of the body to the laboratory, and a residual,
//! which is -1 where there is no pose. It begins at a block whose number has 16 bits.

use std::io::{self, Write};

use super::{
    header::{BLOCK, is_counted_by_length},
    parameters::{DIMENSION_MAX, Parameter, Parameters},
};
use crate::{
    interchange::{
        InterchangeError, Result,
        recorded_rows::{FramePoses, body_names},
    },
    motion::{MotionEvent, MotionInfo},
    poses::{Pose, matrix},
    record::EventKind,
};

/// Name of the group.
const EVENT: &str = "EVENT";
/// The context that carries no information.
const GENERAL: &str = "General";
/// Maximum number of events that an export writes: a dimension is at most 255.
pub(in crate::interchange) const EVENTS_MAX: usize = 255;
/// Maximum number of bytes of all labels together: what one parameter holds.
const LABEL_BYTES_MAX: usize = 32_000;

/// An event as the group stores it.
#[derive(Debug, Clone, PartialEq)]
struct EventEntry {
    context: String,
    label: String,
    description: String,
    subject: String,
    /// Minutes and seconds.
    time: [f32; 2],
    icon: u16,
    flag: u8,
}

impl EventEntry {
    /// The context, unless it is `General`, and the label.
    fn text(&self) -> String {
        let context = self.context.trim();
        let context = if context.eq_ignore_ascii_case(GENERAL) { "" } else { context };
        let mut text = context.to_owned();
        if !text.is_empty() && !self.label.is_empty() {
            text.push(' ');
        }
        text.push_str(&self.label);
        text
    }

    /// The event in a file whose first frame has the number `first_frame`; `None` if it lies outside of the file.
    fn event(&self, rate_hz: f64, first_frame: u64, n_frames: u64) -> Option<MotionEvent> {
        let [minutes, seconds] = self.time.map(f64::from);
        let from_one = ((minutes * 60.0 + seconds) * rate_hz).round();
        let frame = from_one - (first_frame.max(1) - 1) as f64;
        if !(0.0..n_frames as f64).contains(&frame) {
            return None;
        }
        let kind = EventKind::from_name(&self.description).unwrap_or(EventKind::Mark);
        Some(MotionEvent { frame: frame as u64, kind, text: self.text() })
    }
}

/// The entries of the group in file order.
fn entries(parameters: &Parameters) -> Vec<EventEntry> {
    let numbers = |name| parameters.get(EVENT, name).map(Parameter::numbers).unwrap_or_default();
    let times: Vec<f32> = parameters.get(EVENT, "TIMES").map(Parameter::floats).unwrap_or_default();
    let texts = |name: &str| parameters.texts(EVENT, name);
    let (contexts, labels) = (texts("CONTEXTS"), texts("LABELS"));
    let (descriptions, subjects) = (texts("DESCRIPTIONS"), texts("SUBJECTS"));
    let (icons, flags) = (numbers("ICON_IDS"), numbers("GENERIC_FLAGS"));
    let used = parameters.number(EVENT, "USED").map_or(usize::MAX, |used| used as usize);
    let at = |list: &[String], index: usize| list.get(index).cloned().unwrap_or_default();
    let entry = |(index, &time): (usize, &[f32; 2])| EventEntry {
        context: at(&contexts, index),
        label: at(&labels, index),
        description: at(&descriptions, index),
        subject: at(&subjects, index),
        time,
        icon: icons.get(index).map_or(0, |&icon| icon as u16),
        flag: flags.get(index).map_or(0, |&flag| flag as u8),
    };
    times.as_chunks::<2>().0.iter().take(used).enumerate().map(entry).collect()
}

/// The events within the frames of a file. Others remain in the kept group only.
pub(super) fn read(
    parameters: &Parameters,
    rate_hz: f64,
    first_frame: u64,
    n_frames: u64,
) -> Vec<MotionEvent> {
    let entries = entries(parameters);
    let inside = entries.iter().filter_map(|entry| entry.event(rate_hz, first_frame, n_frames));
    let mut events: Vec<_> = inside.collect();
    events.sort_by_key(|event| event.frame);
    events
}

/// Updates the group to the events of `info`. A group with the same events stays unchanged; otherwise entries of events
/// that still exist keep their contexts, exact times and flags.
pub(super) fn fill(parameters: &mut Parameters, info: &MotionInfo, whole: bool) {
    let first_frame = info.source.first_frame.max(1);
    let kept = entries(parameters);
    let known = read(parameters, info.rate_hz, first_frame, info.n_frames);
    let nothing_outside = whole || known.len() == kept.len();
    if known == info.events && nothing_outside {
        return;
    }
    let subject = parameters.text("SUBJECTS", "NAMES").unwrap_or_default();
    let events = select_events(&info.events);
    let label_bytes = LABEL_BYTES_MAX / events.len().max(1);
    let mut left: Vec<Option<EventEntry>> = kept.into_iter().map(Some).collect();
    let entry = |event: &MotionEvent| {
        let same = |entry: &&mut Option<EventEntry>| {
            let found = entry.as_ref();
            let found = found.and_then(|e| e.event(info.rate_hz, first_frame, info.n_frames));
            found.as_ref() == Some(event)
        };
        let kept = left.iter_mut().find(same).and_then(Option::take);
        kept.unwrap_or_else(|| EventEntry {
            context: GENERAL.to_owned(),
            label: cut(event.label(), label_bytes.min(255)).to_owned(),
            description: event.kind.name().to_owned(),
            subject: subject.clone(),
            time: time(first_frame - 1 + event.frame, info.rate_hz),
            icon: 0,
            flag: 0,
        })
    };
    let entries: Vec<EventEntry> = events.into_iter().map(entry).collect();
    set(parameters, &entries);
}

/// Writes the EVENT group: at most 255 events, whose texts fit in one parameter each.
fn set(parameters: &mut Parameters, entries: &[EventEntry]) {
    let n = entries.len().min(DIMENSION_MAX) as u8;
    // Unknown parameters of the old group would belong to other events.
    if let Some(id) = parameters.group_id(EVENT) {
        parameters.parameters.retain(|parameter| parameter.group != id);
    }
    parameters.set_integer(EVENT, "USED", u16::from(n));
    let texts = |text: fn(&EventEntry) -> &String| entries.iter().map(text).cloned().collect();
    let lists: [(&str, Vec<String>); 4] = [
        ("CONTEXTS", texts(|entry| &entry.context)),
        ("LABELS", texts(|entry| &entry.label)),
        ("DESCRIPTIONS", texts(|entry| &entry.description)),
        ("SUBJECTS", texts(|entry| &entry.subject)),
    ];
    for (name, texts) in &lists {
        // Fails, and leaves the list out, only for a text of Latin-1 that exceeds 255 bytes as UTF-8.
        parameters.set_texts(EVENT, name, texts).unwrap_or_default();
    }
    let times = entries.iter().flat_map(|entry| entry.time).flat_map(f32::to_le_bytes);
    parameters.set(EVENT, "TIMES", 4, vec![2, n], times.collect());
    let icons: Vec<u16> = entries.iter().map(|entry| entry.icon).collect();
    parameters.set_integer_list(EVENT, "ICON_IDS", &icons);
    let flags = entries.iter().map(|entry| entry.flag).collect();
    parameters.set(EVENT, "GENERIC_FLAGS", 1, vec![n], flags);
}

/// At most [`EVENTS_MAX`] events in order of time; marks, triggers and sync pulses take precedence over the events of
/// device and host.
fn select_events(events: &[MotionEvent]) -> Vec<&MotionEvent> {
    let is_preferred = |e: &&MotionEvent| !matches!(e.kind, EventKind::Device | EventKind::Host);
    let mut chosen: Vec<_> = events.iter().filter(is_preferred).take(EVENTS_MAX).collect();
    let n_free = EVENTS_MAX - chosen.len();
    chosen.extend(events.iter().filter(|event| !is_preferred(event)).take(n_free));
    chosen.sort_by_key(|event| event.frame);
    chosen
}

/// Minutes and seconds of a frame counted from 0. An f32 of seconds alone would be off by frames after some hours.
fn time(frame: u64, rate_hz: f64) -> [f32; 2] {
    let time_s = frame as f64 / rate_hz;
    let minutes = (time_s / 60.0).floor();
    [minutes as f32, (time_s - 60.0 * minutes) as f32]
}

/// The first characters of a text that fit in `bytes` bytes.
fn cut(text: &str, bytes: usize) -> &str {
    let end = (0..=bytes.min(text.len())).rev().find(|&end| text.is_char_boundary(end));
    text.get(..end.unwrap_or(0)).unwrap_or(text)
}

pub(super) const ROTATION: &str = "ROTATION";

/// Floats of a pose.
const POSE_FLOATS: usize = 17;

/// The largest number of a block at which a section may begin, less those before the data: a header and 255 of parameters.
/// The number has 16 bits, and readers take it as a signed one: ezc3d reads zeros from a section beyond.
const BLOCKS_MAX: u64 = i16::MAX as u64 - 257;

/// The poses of a file.
#[derive(Debug)]
pub(super) struct Rotations<'a> {
    info: &'a MotionInfo,
    n_bodies: u64,
    /// Bytes of the points and analog samples.
    data_bytes: u64,
    /// Whether the section is behind these, as other programs write it. It is before them if they end beyond the last block
    /// at which a section may begin, or if their length tells how many frames there are.
    is_behind: bool,
}

/// Number of blocks.
pub(super) fn blocks(bytes: u64) -> u64 {
    bytes.div_ceil(BLOCK as u64)
}

impl<'a> Rotations<'a> {
    /// The poses of a recording for a file with `frame_bytes` of points and analog samples a frame; `None` if it has none, or
    /// they do not fit.
    pub(super) fn of(info: &'a MotionInfo, frame_bytes: u64) -> Option<Self> {
        let n_bodies = info.recording.as_ref()?.bodies().len() as u64;
        let data_bytes = info.n_frames.saturating_mul(frame_bytes);
        let is_behind = blocks(data_bytes) <= BLOCKS_MAX && !is_counted_by_length(info);
        let found = Self { info, n_bodies, data_bytes, is_behind };
        let fits = is_behind || blocks(found.n_bytes()) <= BLOCKS_MAX;
        (n_bodies > 0 && fits).then_some(found)
    }

    /// The most frames whose poses fit, for a file with `frame_bytes` of points and analog samples a frame.
    pub(super) fn frames_max(frame_bytes: u64) -> u64 {
        let fitting = BLOCKS_MAX * BLOCK as u64 / frame_bytes.max(1);
        fitting.min(u64::from(u16::MAX) - 1)
    }

    /// Whether the section is behind the points and analog samples.
    pub(super) fn is_behind(&self) -> bool {
        self.is_behind
    }

    /// Sets the parameters, as if the section began at block 1: its place is not known yet.
    pub(super) fn fill_parameters(&self, parameters: &mut Parameters) -> Result<()> {
        let names = body_names(self.info);
        parameters.set_integer(ROTATION, "USED", names.len() as u16);
        parameters.set_integer(ROTATION, "DATA_START", 1);
        parameters.set_float(ROTATION, "RATE", self.info.rate_hz as f32);
        parameters.set_integer(ROTATION, "RATIO", 1);
        match u16::try_from(self.info.n_frames) {
            Ok(n_frames) => parameters.set_integer(ROTATION, "FRAMES", n_frames),
            Err(_) => parameters.set_float(ROTATION, "FRAMES", self.info.n_frames as f32),
        }
        let about = names.iter().map(|_| String::new()).collect::<Vec<_>>();
        for (name, texts) in [("LABELS", &names), ("DESCRIPTIONS", &about)] {
            parameters.set_texts(ROTATION, name, texts).map_err(|name| {
                InterchangeError::Unsupported(format!(
                    "C3D names of rigid bodies have at most 255 bytes, but `{name}` has {}",
                    name.len()
                ))
            })?;
        }
        Ok(())
    }

    /// Bytes of the section, whole blocks.
    pub(super) fn n_bytes(&self) -> u64 {
        let n_floats = self.info.n_frames.saturating_mul(self.n_bodies * POSE_FLOATS as u64);
        n_floats.saturating_mul(4).checked_next_multiple_of(BLOCK as u64).unwrap_or(u64::MAX)
    }

    /// Sets the place of the section. Returns the block of the points, if that of the first data is `first`.
    pub(super) fn set_place(&self, parameters: &mut Parameters, first: u16) -> u16 {
        // Both fit, as `of` has found.
        let behind = |bytes: u64| first.saturating_add(blocks(bytes) as u16);
        let (own, points) = match self.is_behind {
            true => (behind(self.data_bytes), first),
            false => (first, behind(self.n_bytes())),
        };
        parameters.set_integer(ROTATION, "DATA_START", own);
        points
    }

    /// Writes the section.
    pub(super) fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(mut poses) = FramePoses::open(self.info) else { return Ok(()) };
        let (mut words, mut n_written) = (Vec::new(), 0);
        for _ in 0..self.info.n_frames {
            words.clear();
            poses.next_frame()?.iter().for_each(|pose| put(pose, &mut words));
            out.write_all(&words)?;
            n_written += words.len() as u64;
        }
        let padding = self.n_bytes().saturating_sub(n_written).min(BLOCK as u64);
        out.write_all(&[0; BLOCK][..padding as usize])
    }
}

fn put(pose: &Pose, out: &mut Vec<u8>) {
    let (matrix, residual) = match pose.is_tracked() {
        true => (matrix(pose).map(|number| number as f32), pose.residual_mm),
        false => ([f32::NAN; 16], -1.0),
    };
    // A residual that is unknown is 0, as that of a point; below 0 there is no pose.
    let residual = if pose.is_tracked() { residual.max(0.0) } else { residual };
    out.extend(matrix.into_iter().chain([residual]).flat_map(f32::to_le_bytes));
}
