//! Events in exported and imported files.

use mocapd_take::interchange::Format;
use mocapd_take::motion::{
    FrameSource, Marker, Motion, MotionEvent, MotionFrames, MotionInfo, Position, Source,
};
use mocapd_take::record::EventKind;

use crate::c3d_file::C3dFile;

fn event(frame: u64, kind: EventKind, text: &str) -> MotionEvent {
    MotionEvent { frame, kind, text: text.to_owned() }
}

fn mark(frame: u64, text: &str) -> MotionEvent {
    event(frame, EventKind::Mark, text)
}

/// One marker at rest at 120 Hz, with these events.
fn motion(n_frames: usize, first_frame: u64, events: Vec<MotionEvent>) -> Motion {
    let info = MotionInfo {
        rate_hz: 120.0,
        n_frames: n_frames as u64,
        markers: vec![Marker { label: "HEAD".to_owned(), labelled: true }],
        source: Source { factor: 1.0, first_frame, ..Source::default() },
        events,
        ..MotionInfo::default()
    };
    Motion { info, positions_mm: vec![[1.0, 2.0, 3.0]; n_frames] }
}

fn write(format: Format, motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    format.write(&mut MotionFrames::new(motion), &mut bytes).expect("memory");
    bytes
}

fn through(format: Format, motion: &Motion) -> Motion {
    format.read(&write(format, motion)).expect("what was written")
}

/// A motion with only some of its frames.
struct Part<'a> {
    info: MotionInfo,
    motion: &'a Motion,
    next: u64,
    end: u64,
}

impl<'a> Part<'a> {
    fn new(motion: &'a Motion, first: u64, end: u64) -> Self {
        let mut info = motion.info.clone();
        info.cut(first, end);
        Self { info, motion, next: first, end }
    }
}

impl FrameSource for Part<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        let more = self.next < self.end;
        if more {
            row.copy_from_slice(self.motion.frame(self.next as usize));
        }
        self.next += u64::from(more);
        Ok(more)
    }
}

#[test]
fn every_kind_of_event_comes_back_from_c3d() {
    let events = vec![
        mark(0, "start"),
        event(7, EventKind::Trigger, "input 2"),
        event(7, EventKind::SyncPulse, "pulse"),
        event(90, EventKind::Device, "temperature"),
        event(119, EventKind::Host, "away for 0.2 s"),
    ];
    for first_frame in [1, 995, 70_000] {
        let source = motion(120, first_frame, events.clone());
        assert_eq!(through(Format::C3d, &source).info.events, events, "from {first_frame}");
    }
}

#[test]
fn marks_come_back_from_tsv() {
    let events = vec![mark(0, "start"), mark(60, "tab\there"), mark(119, "end")];
    for first_frame in [1, 995] {
        let source = motion(120, first_frame, events.clone());
        let written = String::from_utf8(write(Format::Tsv, &source)).expect("text");
        let line = format!("\nEVENT\ttab here\t{}\t0.5\n", first_frame + 60);
        assert!(written.contains(&line), "{written}");
        let back = through(Format::Tsv, &source).info.events;
        assert_eq!(back, [mark(0, "start"), mark(60, "tab here"), mark(119, "end")]);
    }
}

#[test]
fn hours_later_an_event_is_still_at_its_frame() {
    // A float of all seconds would be off by half a frame here.
    let source = motion(3, 4_000_000_000, vec![mark(1, "late")]);
    assert_eq!(through(Format::C3d, &source).info.events, source.info.events);
}

#[test]
fn an_event_without_text_is_labelled_by_its_kind() {
    let source = motion(9, 1, vec![event(3, EventKind::Trigger, "")]);
    let back = through(Format::C3d, &source);
    assert_eq!(back.info.events, [event(3, EventKind::Trigger, "trigger")]);
}

/// A file with an EVENT group as other software writes it, from frame 11 on: of its five events the first is before the
/// first frame, and the last after the last.
fn with_group() -> C3dFile {
    let mut file = C3dFile::new(1, vec![vec![1.0, 2.0, 3.0, 0.0]; 40]);
    file.first_last = (11, 50);
    file.texts(1, "LABELS", &["HEAD"]);
    file.words(1, "FRAMES", &[40]);
    file.records.extend(file.group(7, "EVENT"));
    file.words(7, "USED", &[5]);
    file.texts(7, "CONTEXTS", &["General", "Left", "Right", "Start", "Left"]);
    file.texts(7, "LABELS", &["early", "Foot Strike", "Foot Off", "", "late"]);
    file.texts(7, "SUBJECTS", &["Anne", "Anne", "Anne", "Anne", "Anne"]);
    let times = [0.05f32, 0.104, 0.25, 0.25, 0.7];
    let pairs: Vec<u8> = times.iter().flat_map(|t| [0.0, *t]).flat_map(f32::to_le_bytes).collect();
    file.records.extend(file.record(7, "TIMES", 4, &[2, 5], &pairs));
    file
}

#[test]
fn the_events_of_a_c3d_file_become_those_of_the_take() {
    let source = Format::C3d.read(&with_group().bytes()).expect("a usable file");
    let expected = [mark(0, "Left Foot Strike"), mark(15, "Right Foot Off"), mark(15, "Start")];
    assert_eq!(source.info.events, expected);
}

#[test]
fn an_unchanged_event_group_is_restored_exactly() {
    let source = Format::C3d.read(&with_group().bytes()).expect("a usable file");
    let back = through(Format::C3d, &source);
    assert_eq!(back.info.events, source.info.events);
    let written = write(Format::C3d, &source);
    // Including the one before the first frame, and 0.104 s, which is between two frames.
    let holds = |bytes: &[u8]| written.windows(bytes.len()).any(|window| window == bytes);
    assert!(holds(b"early") && holds(b"late") && holds(&0.104f32.to_le_bytes()));
}

#[test]
fn a_part_has_its_own_events() {
    let source = Format::C3d.read(&with_group().bytes()).expect("a usable file");
    let mut part = Part::new(&source, 10, 40);
    let mut bytes = Vec::new();
    Format::C3d.write(&mut part, &mut bytes).expect("memory");
    let back = Format::C3d.read(&bytes).expect("what was written");
    assert_eq!(back.info.events, [mark(5, "Right Foot Off"), mark(5, "Start")]);
    assert_eq!(back.info.source.first_frame, 21);
    assert!(!bytes.windows(5).any(|window| window == b"early"));
    assert!(bytes.windows(4).any(|window| window == b"Anne"));
}

#[test]
fn an_added_event_joins_those_of_the_file() {
    let mut source = Format::C3d.read(&with_group().bytes()).expect("a usable file");
    source.info.events.insert(1, mark(4, "now"));
    let back = through(Format::C3d, &source);
    assert_eq!(back.info.events, source.info.events);
    assert!(write(Format::C3d, &source).windows(4).any(|window| window == b"Left"));
}

#[test]
fn events_beyond_the_limit_of_a_group_are_reported_and_marks_come_first() {
    let mut events: Vec<_> = (0..300).map(|i| event(i, EventKind::Host, "noticed")).collect();
    events.insert(280, mark(279, &"m\u{e9}".repeat(200)));
    let source = motion(300, 1, events);
    assert_eq!(Format::C3d.leaves_out(&source.info, false), ["46 events"]);
    let back = through(Format::C3d, &source).info.events;
    assert_eq!(back.len(), 255);
    let marks: Vec<_> = back.iter().filter(|event| event.kind == EventKind::Mark).collect();
    assert_eq!(marks.len(), 1);
    assert_eq!((marks[0].frame, marks[0].text.len()), (279, 124));
}

#[test]
fn parts_keep_the_events_between_their_ends() {
    let mut info = motion(10, 5, vec![mark(0, "a"), mark(4, "b"), mark(10, "end")]).info;
    let whole = info.clone();
    info.cut(0, 10);
    assert_eq!(info, whole);
    info.cut(2, 10);
    assert_eq!(info.events, [mark(2, "b"), mark(8, "end")]);
    assert_eq!((info.n_frames, info.source.first_frame), (8, 7));
    info.cut(0, 2);
    assert_eq!(info.events, []);
}
