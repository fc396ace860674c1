//! The EVENT group, which holds the events of a trial.
//!
//! Its parameters have one element for each event: texts in CONTEXTS, LABELS, DESCRIPTIONS and SUBJECTS, minutes and
//! seconds in TIMES, integers in `ICON_IDS` and bytes in `GENERIC_FLAGS`. Times count from frame number 1, not from the
//! first frame of the file, as in Vicon's software and BTK.

use super::parameters::{DIMENSION_MAX, Parameter, Parameters};
use crate::motion::{MotionEvent, MotionInfo};
use crate::record::EventKind;

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
