//! Compares the OpenAPI document with the API.

use std::collections::{BTreeMap, BTreeSet};

use mocapd_acquire::{
    files::FileState,
    ledger::{GroupLedgerDocument, LedgerDocument, SampleLedgerDocument},
    rig::ListedDevice,
};
use mocapd_service::{
    control::{FirstFrame, Mark, Marked, Request, SaveLast, Start, Started, Stopped},
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, TakeRating, Trash, TrashedTake},
    http::{Problem, ProblemKind, openapi},
    live::{LiveFace, LiveLimb},
    playback::{
        BodyList, GapBins, LargestError, PlateList, PlateOverview, PlaybackEvent, TakeDifference,
        TakeOverview,
    },
    status::{
        ArchiveStatus, DeviceStatus, MarkerQuality, OutageStatus, PendingStart, PublishStatus,
        PublishedClient, ServiceEvent, ServiceEventKind, State, Status, TakeStatus, TakeSummary,
        TakeUpload, TrialNames,
    },
};
use serde_json::{Value, json};

use super::{
    client::{ask, get, post},
    serve,
};

/// Every route: method and path.
const ROUTES: &[(&str, &str)] = &[
    ("get", "/healthz"),
    ("get", "/login"),
    ("get", "/metrics"),
    ("get", "/openapi.json"),
    ("get", "/v1/devices"),
    ("get", "/v1/events"),
    ("get", "/v1/live"),
    ("get", "/v1/quality"),
    ("get", "/v1/status"),
    ("get", "/v1/takes"),
    ("get", "/v1/takes/{name}/bodies"),
    ("get", "/v1/takes/{name}/difference"),
    ("get", "/v1/takes/{name}/download"),
    ("get", "/v1/takes/{name}/face"),
    ("get", "/v1/takes/{name}/forces"),
    ("get", "/v1/takes/{name}/gaps"),
    ("get", "/v1/takes/{name}/notes"),
    ("get", "/v1/takes/{name}/overview"),
    ("get", "/v1/takes/{name}/plates"),
    ("get", "/v1/takes/{name}/poses"),
    ("get", "/v1/takes/{name}/window"),
    ("get", "/v1/trash"),
    ("post", "/login"),
    ("post", "/logout"),
    ("post", "/v1/arm"),
    ("post", "/v1/cancel"),
    ("post", "/v1/disarm"),
    ("post", "/v1/mark"),
    ("post", "/v1/save-last"),
    ("post", "/v1/start"),
    ("post", "/v1/stop"),
    ("post", "/v1/takes/{name}/notes"),
    ("post", "/v1/takes/{name}/rename"),
    ("post", "/v1/takes/{name}/trash"),
    ("post", "/v1/takes/{name}/verify"),
    ("post", "/v1/trash/{id}/restore"),
];

fn document() -> Value {
    serde_json::from_str(&openapi().unwrap()).unwrap()
}

#[test]
fn the_document_and_the_server_have_the_same_routes() {
    let document = document();
    let mut described = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            described.insert((method.as_str(), path.as_str()));
            assert!(operation["summary"].is_string(), "{method} {path} has no summary");
            let problem = &operation["responses"]["default"]["content"]["application/problem+json"];
            assert_eq!(
                problem["schema"]["$ref"], "#/components/schemas/Problem",
                "{method} {path}"
            );
        }
    }
    assert_eq!(described, ROUTES.iter().copied().collect());
    let served = serve();
    assert_eq!(get(served.at, "/openapi.json").json(), document);
    for &(method, path) in ROUTES {
        let path = path.replace("{name}", "none").replace("{id}", "none");
        // A method that is not described is not allowed.
        let other = if method == "get" { "post" } else { "get" };
        if !described.contains(&(other, path.as_str())) && !path.contains("none") {
            let refused = ask(served.at, &other.to_uppercase(), &path, &[], "");
            refused.refused(405, "method_not_allowed");
        }
        if method == "post" {
            let answer = ask(served.at, "POST", &path, &[("content-type", "x/y")], "");
            assert!([303, 415].contains(&answer.status), "{path}: {}", answer.status);
        } else if !["/v1/events", "/v1/live"].contains(&path.as_str()) {
            let expected = if path.contains("none") { 404 } else { 200 };
            assert_eq!(ask(served.at, "HEAD", &path, &[], "").status, expected, "{path}");
        }
    }
}

/// An example of each type, with every optional field set.
fn examples() -> Vec<(&'static str, Value)> {
    let outage = OutageStatus { ends_in_s: Some(1.0), ..OutageStatus::default() };
    let groups = vec![GroupLedgerDocument::default()];
    let samples = SampleLedgerDocument { groups, ..SampleLedgerDocument::default() };
    let status = Status {
        device: DeviceStatus { outage: Some(outage), ..DeviceStatus::default() },
        take: Some(TakeStatus { sample_ledger: Some(samples), ..TakeStatus::default() }),
        pending_start: Some(PendingStart {
            name: Some("jump".to_owned()),
            remarks: vec!["x".to_owned()],
            ..PendingStart::default()
        }),
        missed_start: Some("x".to_owned()),
        names: Some(TrialNames::default()),
        last_take: Some(TakeSummary {
            upload: Some(TakeUpload::default()),
            notes: Some(TakeNotes { problem: Some("x".to_owned()), ..TakeNotes::default() }),
            ..TakeSummary::default()
        }),
        archive: Some(ArchiveStatus::default()),
        publish: vec![PublishStatus {
            clients: vec![PublishedClient::default()],
            ..PublishStatus::default()
        }],
        ..Status::default()
    };
    let first_frame = FirstFrame { device_ticks: 1, arrival_ns: 2, before_request_s: 0.5 };
    let started = Started {
        take_id: String::new(),
        name: String::new(),
        path: "x".into(),
        first_frame,
        remarks: vec!["x".to_owned()],
    };
    let stopped = Stopped {
        take_id: String::new(),
        name: String::new(),
        path: "x".into(),
        rows: 1,
        seconds: 1.0,
        bytes: 1,
        ending: None,
        ledger: LedgerDocument::default(),
        file: FileState::Renamed,
        short_by_s: 1.0,
        remarks: vec!["x".to_owned()],
    };
    let event = ServiceEvent {
        number: 1,
        unix_ms: 1,
        kind: ServiceEventKind::Mark,
        message: String::new(),
        state: State::Armed,
        take: None,
        notes: Some("left shoe".to_owned()),
    };
    let device = ListedDevice {
        device: String::new(),
        manufacturer: None,
        product: None,
        serial: None,
        driver: None,
        certain: true,
        problem: None,
    };
    let overview = TakeOverview {
        labels: vec!["a".to_owned()],
        labelled: vec![true],
        bones: vec![[0, 1]],
        limbs: vec![LiveLimb::default()],
        face: Some(LiveFace { vertices_mm: vec![[1.0; 3]], lines: vec![[0, 0]] }),
        frames_lost: Some(1),
        samples_missing: Some(1),
        events: vec![PlaybackEvent::default()],
        problems: vec!["x".to_owned()],
        ..TakeOverview::default()
    };
    let id = Some("a".to_owned());
    let request = Request { request_id: id.clone() };
    let start = Start {
        request_id: id.clone(),
        name: id.clone(),
        notes: id.clone(),
        pre_roll_s: Some(1.0),
        seconds: Some(1.0),
        at: id.clone(),
        subject: id.clone(),
        session: id.clone(),
        trial: id.clone(),
    };
    let edit = EditNotes {
        request_id: id.clone(),
        take_id: id.clone(),
        rating: Some(TakeRating::Good),
        text: id.clone(),
    };
    let rename = Rename { request_id: id.clone(), take_id: id.clone(), to: String::new() };
    let trash = Trash { request_id: id.clone(), take_id: id.clone() };
    let restore = Restore { request_id: id.clone(), to: id.clone() };
    let moved = MovedTake { name: String::new(), path: "x".into(), remarks: vec!["x".to_owned()] };
    let mark = Mark { request_id: id.clone(), text: String::new() };
    let save = SaveLast { request_id: id.clone(), name: id, seconds: Some(1.0) };
    let problem = Problem { status: 400, kind: ProblemKind::Invalid, message: String::new() };
    let value = |value: serde_json::Result<Value>| value.unwrap();
    vec![
        ("Status", value(serde_json::to_value(status))),
        ("Started", value(serde_json::to_value(started))),
        ("Stopped", value(serde_json::to_value(stopped))),
        ("Marked", value(serde_json::to_value(Marked { row: 1 }))),
        ("ServiceEvent", value(serde_json::to_value(event))),
        ("MarkerQuality", value(serde_json::to_value(MarkerQuality::default()))),
        ("ListedDevice", value(serde_json::to_value(device))),
        ("Request", value(serde_json::to_value(request))),
        ("Start", value(serde_json::to_value(start))),
        ("Mark", value(serde_json::to_value(mark))),
        ("EditNotes", value(serde_json::to_value(edit))),
        ("Rename", value(serde_json::to_value(rename))),
        ("Trash", value(serde_json::to_value(trash))),
        ("Restore", value(serde_json::to_value(restore))),
        ("MovedTake", value(serde_json::to_value(moved))),
        ("TrashedTake", value(serde_json::to_value(TrashedTake::default()))),
        ("SaveLast", value(serde_json::to_value(save))),
        ("TakeOverview", value(serde_json::to_value(overview))),
        (
            "GapBins",
            value(serde_json::to_value(GapBins {
                missing_samples: vec![1],
                lost_frames: vec![1],
                ..GapBins::new(1)
            })),
        ),
        (
            "BodyList",
            value(serde_json::to_value(BodyList {
                names: vec!["wand".to_owned()],
                window_frames_max: 1,
            })),
        ),
        (
            "PlateList",
            value(serde_json::to_value(PlateList {
                plates: vec![PlateOverview { name: "1".to_owned(), corners_mm: [[1.0; 3]; 4] }],
                window_frames_max: 1,
                unusable: vec!["2: no channels".to_owned()],
            })),
        ),
        (
            "TakeDifference",
            value(serde_json::to_value(TakeDifference {
                markers: vec![Some(1)],
                max_error_mm: vec![Some(0.5)],
                largest: Some(LargestError { error_mm: 0.5, frame: 1, marker: 0 }),
                ..TakeDifference::default()
            })),
        ),
        ("Problem", value(serde_json::to_value(problem))),
        ("Health", json!({"state": "idle"})),
    ]
}

/// Compares a value with its schema: both have the same fields, and the types match.
fn compare(
    path: &str,
    value: &Value,
    schema: &Value,
    document: &Value,
    seen: &mut BTreeSet<String>,
) {
    if let Some(name) = schema["$ref"].as_str() {
        let name = name.strip_prefix("#/components/schemas/").unwrap();
        seen.insert(name.to_owned());
        let found = &document["components"]["schemas"][name];
        assert!(found.is_object(), "{path}: {name} is not described");
        return compare(path, value, found, document, seen);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let is_null = |choice: &&Value| choice["type"] == "null";
        let choice = choices.iter().find(|choice| is_null(choice) == value.is_null()).unwrap();
        return compare(path, value, choice, document, seen);
    }
    let types: Vec<_> = match &schema["type"] {
        Value::Array(types) => types.iter().filter_map(Value::as_str).collect(),
        one => one.as_str().into_iter().collect(),
    };
    let is = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    assert!(types.contains(&is), "{path} is {is}, described as {types:?}");
    if let Some(choices) = schema["enum"].as_array() {
        assert!(choices.contains(value), "{path}: {value} is not one of {choices:?}");
    }
    match value {
        Value::Object(fields) => {
            let empty = serde_json::Map::new();
            let described = schema["properties"].as_object().unwrap_or(&empty);
            let names =
                |map: &serde_json::Map<String, Value>| map.keys().cloned().collect::<BTreeSet<_>>();
            assert_eq!(names(fields), names(described), "{path}");
            for (name, field) in fields {
                let text = described[name].to_string();
                assert!(
                    text.contains("\"description\"") || path.contains("ledger"),
                    "{path}.{name}"
                );
                compare(&format!("{path}.{name}"), field, &described[name], document, seen);
            }
        }
        Value::Array(items) => {
            for item in items {
                compare(&format!("{path}[]"), item, &schema["items"], document, seen);
            }
        }
        _ => {}
    }
}

#[test]
fn every_field_is_described_and_every_described_field_exists() {
    let document = document();
    let mut seen = BTreeSet::new();
    for (name, value) in examples() {
        let schema = json!({"$ref": format!("#/components/schemas/{name}")});
        compare(name, &value, &schema, &document, &mut seen);
    }
    let served = serve();
    post(served.at, "/v1/start", r#"{"name": "a"}"#);
    post(served.at, "/v1/stop", "{}");
    let checked = post(served.at, "/v1/takes/a/verify", "{}").json();
    let schema = json!({"$ref": "#/components/schemas/TakeCheck"});
    compare("TakeCheck", &checked, &schema, &document, &mut seen);
    let described: BTreeSet<_> =
        document["components"]["schemas"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(seen, described, "a type that is never sent");
    // Unknown fields of a request are refused, and the document says so.
    for name in ["Request", "Start", "Mark", "SaveLast", "EditNotes", "Rename", "Restore", "Trash"]
    {
        assert_eq!(
            document["components"]["schemas"][name]["additionalProperties"], false,
            "{name}"
        );
    }
}

#[test]
fn metrics_are_sent_in_the_requested_format() {
    let served = serve();
    let old = get(served.at, "/metrics");
    assert_eq!(old.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    let text = String::from_utf8(old.body).unwrap();
    assert!(text.contains("\nmocapd_input_frames_total 12345\n"), "{text}");
    assert!(text.contains("\nmocapd_input_ring_latency_p99_seconds 0.000045\n"), "{text}");
    let accept = [("accept", "application/openmetrics-text;version=1.0.0,text/plain;q=0.5")];
    let new = ask(served.at, "GET", "/metrics", &accept, "");
    assert!(new.header("content-type").unwrap().starts_with("application/openmetrics-text"));
    assert!(new.body.ends_with(b"# EOF\n"));
    // Each metric has one help text and one type.
    let mut types: BTreeMap<&str, &str> = BTreeMap::new();
    for line in text.lines() {
        if let Some((name, kind)) = line.strip_prefix("# TYPE ").and_then(|l| l.split_once(' ')) {
            assert!(types.insert(name, kind).is_none(), "{name} occurs twice");
            assert!(text.contains(&format!("# HELP {name} ")), "{name} has no help");
            assert_eq!(name.ends_with("_total"), kind == "counter", "{name}");
        }
    }
    assert!(types.len() > 25, "{types:?}");
}
