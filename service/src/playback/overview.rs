//! The overview of a take: everything that a player needs before the first window.

use mocapd_report::labels::marker_lines;
use mocapd_take::{
    TakeMap,
    damage::Problem,
    motion::MotionInfo,
    record::{Event, Ledger},
    statistics::TakeStatistics,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::window::{frames_max, labels};
use crate::{
    live::{LiveFace, LiveLimb},
    subject::{FaceOverlay, live_limbs, with_limbs},
};

/// Maximum number of events in an overview: more than a time axis can show.
const EVENTS_MAX: usize = 1000;

/// Maximum length of an event's text in characters, and of the name of a source.
const TEXT_CHARS_MAX: usize = 200;

/// Maximum number of problems in an overview.
const PROBLEMS_MAX: usize = 20;

/// A take as a player sees it before it reads any frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeOverview {
    /// Name, without `.take`.
    pub name: String,
    /// The device, or the name of the imported file.
    pub source: String,
    /// When the take was made, in milliseconds since 1970; 0 if unknown.
    pub created_unix_ms: i64,
    /// Number of frames, including lost ones.
    pub frames: u64,
    /// Number of the first frame in its source: 1, or that of an excerpt or of an imported file.
    pub first_frame: u64,
    /// Frame rate in Hz.
    pub rate_hz: f64,
    /// Length in seconds.
    pub seconds: f64,
    /// Number of markers.
    pub markers: usize,
    /// Labels of the markers, in order; empty for a marker without one.
    pub labels: Vec<String>,
    /// Whether the marker is identified, by marker.
    pub labelled: Vec<bool>,
    /// The vertical axis: 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// Pairs of markers to join by a line.
    pub bones: Vec<[u16; 2]>,
    /// The lines that are limbs of the subject's skeleton.
    pub limbs: Vec<LiveLimb>,
    /// The wireframe of the subject's face, if its markers are mapped; `face` has its poses.
    pub face: Option<LiveFace>,
    /// Largest distance in millimetres between a sample and its original; 0 for a lossless take.
    pub tolerance_mm: f64,
    /// Number of lost frames by the last ledger; null if there is none.
    pub frames_lost: Option<u64>,
    /// Number of samples that are missing in recorded frames; null if the take does not state it.
    pub samples_missing: Option<u64>,
    /// The first thousand events and marks, in order of their frames.
    pub events: Vec<PlaybackEvent>,
    /// Number of all events and marks.
    pub events_total: usize,
    /// The first twenty problems of a damaged take.
    pub problems: Vec<String>,
    /// Number of all problems.
    pub problems_total: usize,
    /// Whether the take was searched for events, marks and problems. If not, they are still to be requested.
    pub is_complete: bool,
    /// Maximum number of frames of a window: a response has at most a megabyte.
    pub window_frames_max: u64,
}

/// An event on a time axis.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct PlaybackEvent {
    /// The frame that it belongs to.
    pub frame: u64,
    /// `mark`, `trigger`, `sync pulse`, `device` or `host`.
    pub kind: String,
    /// Its text, cut to 200 characters.
    pub text: String,
}

impl TakeOverview {
    /// The overview of a take with this map, which [`TakeMap::open`] reads without decoding anything. Damage within a stretch
    /// therefore shows only in windows and gaps. With [the map of its ends](super::map_of_ends) it is not complete.
    #[must_use]
    pub fn of(name: &str, map: &TakeMap) -> Self {
        let header = &map.header;
        let labels = labels(map);
        let recorded = map.ledger.as_ref().map(|ledger| ledger.recorded);
        let samples = map.statistics.as_ref().map(TakeStatistics::samples);
        let missing = recorded.zip(samples).map(|(rows, samples)| {
            rows.saturating_mul(map.channels.len() as u64).saturating_sub(samples)
        });
        let mut events: Vec<&Event> = map.events.iter().collect();
        events.sort_by_key(|event| event.row);
        let source = match (&header.device, &header.source) {
            (Some(device), _) => format!("{} {}", device.model, device.serial).trim().to_owned(),
            (None, Some(source)) => source.file.clone(),
            (None, None) => String::new(),
        };
        let limbs = live_limbs(map.subject.as_ref(), &labels);
        let face = FaceOverlay::new(map.subject.as_ref(), &labels);
        Self {
            name: name.to_owned(),
            source: cut(&source),
            created_unix_ms: header.created_unix_ms,
            frames: map.n_rows,
            first_frame: header.source.as_ref().map_or(1, |source| source.first_frame),
            rate_hz: header.rate_hz,
            seconds: map.n_rows as f64 / header.rate_hz,
            markers: labels.len(),
            labelled: map.channels.iter().map(|channel| channel.labelled).collect(),
            up_axis: header.up_axis.code(),
            bones: with_limbs(marker_lines(&labels), &limbs),
            limbs,
            face: face.as_ref().map(FaceOverlay::wireframe),
            labels,
            tolerance_mm: header.tolerance_mm,
            frames_lost: map.ledger.as_ref().map(Ledger::frames_lost),
            samples_missing: missing,
            events_total: events.len(),
            events: events.into_iter().take(EVENTS_MAX).map(PlaybackEvent::from).collect(),
            window_frames_max: frames_max(map.channels.len()),
            is_complete: true,
            ..Self::default()
        }
        .with_problems(&map.problems)
    }

    fn with_problems(mut self, problems: &[Problem]) -> Self {
        self.set_problems(problems);
        self
    }

    /// Replaces the problems of the take.
    pub fn set_problems(&mut self, problems: &[Problem]) {
        self.problems = problems.iter().take(PROBLEMS_MAX).map(ToString::to_string).collect();
        self.problems_total = problems.len();
    }
}

impl TakeOverview {
    /// The overview of what an export of a take has: its frames, markers and events may be fewer, and rotated.
    #[must_use]
    pub fn of_export(name: &str, map: &TakeMap, info: &MotionInfo) -> Self {
        let labels: Vec<String> = info.markers.iter().map(|marker| marker.label.clone()).collect();
        let events = info.events.iter().take(EVENTS_MAX);
        let limbs = live_limbs(map.subject.as_ref(), &labels);
        Self {
            frames: info.n_frames,
            first_frame: info.source.first_frame,
            seconds: info.n_frames as f64 / info.rate_hz,
            bones: with_limbs(marker_lines(&labels), &limbs),
            limbs,
            // A page has no poses of it.
            face: None,
            labels,
            up_axis: info.up.code(),
            events_total: info.events.len(),
            events: events
                .map(|event| PlaybackEvent {
                    frame: event.frame,
                    kind: event.kind.name().to_owned(),
                    text: cut(&event.text),
                })
                .collect(),
            ..Self::of(name, map)
        }
    }
}

impl From<&Event> for PlaybackEvent {
    fn from(event: &Event) -> Self {
        let Event { row, kind, text, .. } = event;
        Self { frame: *row, kind: kind.name().to_owned(), text: cut(text) }
    }
}

/// A text of at most [`TEXT_CHARS_MAX`] characters.
fn cut(text: &str) -> String {
    text.chars().take(TEXT_CHARS_MAX).collect()
}
