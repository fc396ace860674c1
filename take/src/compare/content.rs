//! Compares what two takes state besides their samples and times.

use serde::Serialize;

use crate::{
    TakeMap,
    foreign::content::Content,
    motion::Foreign,
    record::{Event, Header, Ledger, Subject},
};

/// A statement that differs between two takes; `None` in a take that lacks it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FieldDifference {
    /// Its name.
    pub field: String,
    /// In the first take.
    pub a: Option<String>,
    /// In the second take.
    pub b: Option<String>,
}

/// An event that only one of two takes has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EventDifference {
    /// Which take has it: `a` or `b`.
    pub only_in: &'static str,
    /// Its frame, from 0.
    pub frame: u64,
    /// Its kind.
    pub kind: &'static str,
    /// Its text.
    pub text: String,
}

/// How two takes differ besides their samples and times.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ContentDifference {
    /// Fields of the header.
    pub header: Vec<FieldDifference>,
    /// Settings in the header.
    pub settings: Vec<FieldDifference>,
    /// The captured subject: the name, and the documents by kind.
    pub subject: Vec<FieldDifference>,
    /// Events.
    pub events: Vec<EventDifference>,
    /// Counters of the last ledger, and how the take ended.
    pub ledger: Vec<FieldDifference>,
    /// Foreign parts, by kind.
    pub foreign: Vec<FieldDifference>,
}

impl ContentDifference {
    /// Compares two takes. Each comes with its map and the content of its foreign parts.
    #[must_use]
    pub fn between(a: (&TakeMap, &[Foreign]), b: (&TakeMap, &[Foreign])) -> Self {
        let [(one, one_foreign), (other, other_foreign)] = [a, b];
        let mut ledger = differing(ledger_fields(one), ledger_fields(other));
        let ending = |map: &TakeMap| {
            let ending = map.ending.as_ref()?;
            Some(match ending.detail.as_str() {
                "" => ending.kind.to_string(),
                detail => format!("{}: {detail}", ending.kind),
            })
        };
        ledger.extend(field("ending", ending(one), ending(other)));
        Self {
            header: differing(header_fields(&one.header), header_fields(&other.header)),
            settings: differing(one.header.settings.clone(), other.header.settings.clone()),
            subject: subject_differences(one.subject.as_ref(), other.subject.as_ref()),
            events: event_differences(&one.events, &other.events),
            ledger,
            foreign: foreign_differences(one_foreign, other_foreign),
        }
    }

    /// Whether nothing differs.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// The difference of a field, if there is one.
fn field(name: &str, a: Option<String>, b: Option<String>) -> Option<FieldDifference> {
    (a != b).then(|| FieldDifference { field: name.to_owned(), a, b })
}

/// The differences of two lists of fields. A field that occurs several times is compared occurrence by occurrence.
fn differing(a: Vec<(String, String)>, b: Vec<(String, String)>) -> Vec<FieldDifference> {
    let mut found = Vec::new();
    let mut others: Vec<Option<(String, String)>> = b.into_iter().map(Some).collect();
    for (name, value) in a {
        let same = others.iter_mut().find(|other| other.as_ref().is_some_and(|o| o.0 == name));
        let other = same.and_then(Option::take).map(|(_, value)| value);
        found.extend(field(&name, Some(value), other));
    }
    found.extend(others.into_iter().flatten().filter_map(|(name, b)| field(&name, None, Some(b))));
    found
}

fn header_fields(header: &Header) -> Vec<(String, String)> {
    let mut fields = vec![
        ("software", header.software.clone()),
        ("take_id", header.take_id_text()),
        ("created_unix_ms", header.created_unix_ms.to_string()),
        ("resampler", header.resampler.clone()),
        ("codec_version", header.codec_version.to_string()),
        ("tolerance_mm", header.tolerance_mm.to_string()),
        ("rate_hz", header.rate_hz.to_string()),
        ("up_axis", header.up_axis.name().unwrap_or("unknown").to_owned()),
        ("stretch_rows", header.stretch_rows.to_string()),
    ];
    if let Some(device) = &header.device {
        fields.extend([
            ("device.driver", device.driver.clone()),
            ("device.uri", device.uri.clone()),
            ("device.model", device.model.clone()),
            ("device.serial", device.serial.clone()),
            ("device.firmware", device.firmware.clone()),
            ("device.tick_hz", device.tick_hz.to_string()),
            ("device.low_latency", device.low_latency.to_string()),
        ]);
    }
    if let Some(source) = &header.source {
        fields.extend([
            ("source.format", source.format.clone()),
            ("source.file", source.file.clone()),
            ("source.unit", source.unit.clone()),
            ("source.factor_to_mm", source.factor.to_string()),
            ("source.first_frame", source.first_frame.to_string()),
            ("source.warnings", source.warnings.join(" ")),
        ]);
    }
    fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn ledger_fields(map: &TakeMap) -> Vec<(String, String)> {
    let Some(ledger) = &map.ledger else { return Vec::new() };
    let mut fields: Vec<(String, String)> =
        ledger.counters().map(|(name, count)| (name.to_owned(), count.to_string())).to_vec();
    let Ledger { contradictions, clock, .. } = ledger;
    fields.extend(contradictions.iter().map(|text| ("contradiction".to_owned(), text.clone())));
    let line = clock.map(|clock| format!("{} ns, {} ppm", clock.offset_ns, clock.drift_ppm));
    fields.extend(line.map(|line| ("clock".to_owned(), line)));
    fields
}

fn subject_differences(a: Option<&Subject>, b: Option<&Subject>) -> Vec<FieldDifference> {
    let name = |subject: Option<&Subject>| subject.map(|subject| subject.name.clone());
    let mut found: Vec<_> = field("name", name(a), name(b)).into_iter().collect();
    let documents = |subject: Option<&Subject>| -> Vec<(String, Vec<u8>)> {
        let documents = subject.iter().flat_map(|subject| &subject.documents);
        documents.map(|document| (document.kind.clone(), document.data.clone())).collect()
    };
    found.extend(content_differences(&documents(a), &documents(b), |data| data.len() as u64));
    found
}

fn foreign_differences(a: &[Foreign], b: &[Foreign]) -> Vec<FieldDifference> {
    let parts = |parts: &[Foreign]| -> Vec<_> {
        parts.iter().map(|part| (part.kind.clone(), part.data.clone())).collect()
    };
    content_differences(&parts(a), &parts(b), Content::len)
}

/// Compares contents by kind. A difference gives their sizes in bytes.
fn content_differences<T: PartialEq>(
    a: &[(String, T)],
    b: &[(String, T)],
    len: impl Fn(&T) -> u64,
) -> Vec<FieldDifference> {
    let of = |all: &[(String, T)], kind: &str| all.iter().position(|(found, _)| found == kind);
    let bytes = |content: &T, other: &str| Some(format!("{} {other}bytes", len(content)));
    let mut found = Vec::new();
    for (kind, content) in a {
        let (a, b) = match of(b, kind).map(|i| &b[i].1) {
            None => (bytes(content, ""), None),
            Some(same) if same == content => continue,
            Some(other) => (bytes(content, ""), bytes(other, "other ")),
        };
        found.push(FieldDifference { field: kind.clone(), a, b });
    }
    for (kind, content) in b.iter().filter(|(kind, _)| of(a, kind).is_none()) {
        found.push(FieldDifference { field: kind.clone(), a: None, b: bytes(content, "") });
    }
    found
}

/// The events that only one take has, in order of frames.
fn event_differences(a: &[Event], b: &[Event]) -> Vec<EventDifference> {
    let sorted = |events: &[Event]| -> Vec<Event> {
        let mut sorted = events.to_vec();
        sorted.sort_by(|a, b| key(a).cmp(&key(b)));
        sorted
    };
    let (a, b) = (sorted(a), sorted(b));
    let (mut at, mut found) = ([0, 0], Vec::new());
    loop {
        let (one, other) = (a.get(at[0]), b.get(at[1]));
        let order = match (one, other) {
            (None, None) => return found,
            (Some(_), None) => std::cmp::Ordering::Less,
            (None, Some(_)) => std::cmp::Ordering::Greater,
            (Some(one), Some(other)) => key(one).cmp(&key(other)),
        };
        at[0] += usize::from(order.is_le());
        at[1] += usize::from(order.is_ge());
        let (only_in, event) = if order.is_lt() { ("a", one) } else { ("b", other) };
        let difference = |event: &Event| EventDifference {
            only_in,
            frame: event.row,
            kind: event.kind.name(),
            text: event.text.clone(),
        };
        found.extend(event.filter(|_| order.is_ne()).map(difference));
    }
}

/// Everything in an event, beginning with its frame.
fn key(event: &Event) -> (u64, &'static str, &str, [u64; 3]) {
    let Event { kind, row, device_ticks, host_ns, input, text } = event;
    (*row, kind.name(), text, [*device_ticks, *host_ns, u64::from(*input)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Document, EventKind, TakeEnding};

    fn event(row: u64, text: &str) -> Event {
        Event { row, ..Event::new(EventKind::Mark, 0, text) }
    }

    fn names(fields: &[FieldDifference]) -> Vec<&str> {
        fields.iter().map(|difference| difference.field.as_str()).collect()
    }

    #[test]
    fn the_order_of_events_is_not_a_difference() {
        let mut a = TakeMap { events: vec![event(3, "b"), event(1, "a")], ..TakeMap::default() };
        let mut b = TakeMap { events: vec![event(1, "a"), event(3, "b")], ..TakeMap::default() };
        (a.ledger, b.ledger) = (Some(Ledger::default()), Some(Ledger::default()));
        let part = [Foreign::exact("c3d/analog", vec![1, 2])];
        assert!(ContentDifference::between((&a, &part), (&b, &part)).is_none());
    }

    #[test]
    fn every_kind_of_difference_is_found() {
        let a = TakeMap {
            header: Header {
                rate_hz: 60.0,
                settings: vec![
                    ("unit".to_owned(), "m".to_owned()),
                    ("x".to_owned(), "1".to_owned()),
                ],
                ..Header::default()
            },
            subject: Some(Subject {
                name: "Anna".to_owned(),
                documents: vec![Document { kind: "face".to_owned(), data: vec![1] }],
            }),
            events: vec![event(1, "a"), event(2, "b")],
            ledger: Some(Ledger { recorded: 5, ..Ledger::default() }),
            ..TakeMap::default()
        };
        let b = TakeMap {
            header: Header {
                rate_hz: 120.0,
                settings: vec![("x".to_owned(), "2".to_owned())],
                ..Header::default()
            },
            subject: Some(Subject {
                name: "Anna".to_owned(),
                documents: vec![Document { kind: "face".to_owned(), data: vec![2] }],
            }),
            events: vec![event(1, "a"), event(2, "c")],
            ledger: Some(Ledger { recorded: 7, ..Ledger::default() }),
            ending: Some(TakeEnding::default()),
            ..TakeMap::default()
        };
        let part = [Foreign::exact("trc/header", vec![0; 9])];
        let found = ContentDifference::between((&a, &part), (&b, &[]));
        assert_eq!(names(&found.header), ["rate_hz"]);
        assert_eq!(names(&found.settings), ["unit", "x"]);
        assert_eq!(found.settings[0].b, None);
        assert_eq!(names(&found.subject), ["face"]);
        assert_eq!(names(&found.ledger), ["recorded", "ending"]);
        assert_eq!(names(&found.foreign), ["trc/header"]);
        let events: Vec<_> = found.events.iter().map(|e| (e.only_in, e.frame, &*e.text)).collect();
        assert_eq!(events, [("a", 2, "b"), ("b", 2, "c")]);
        // The other way around: the same differences, with sides exchanged.
        let back = ContentDifference::between((&b, &[]), (&a, &part));
        assert_eq!(back.settings.len(), found.settings.len());
        assert_eq!(
            (&back.foreign[0].a, &back.foreign[0].b),
            (&found.foreign[0].b, &found.foreign[0].a)
        );
    }
}
