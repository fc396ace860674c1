//! The figures of the status for Prometheus.

mod figures;

use std::sync::Arc;

use axum::{
    extract::State,
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use prometheus_client::{encoding::text::encode, registry::Registry};

use self::figures::Figures;
use super::{problem::Problem, state::Shared};

const OPEN_METRICS: &str = "application/openmetrics-text";

/// The figures of the status, for Prometheus
///
/// In the text format of `OpenMetrics`, if the client accepts that, and else in Prometheus' own.
#[utoipa::path(get, path = "/metrics", tag = "status", responses((status = 200, content(
    (String = "text/plain; version=0.0.4; charset=utf-8"),
    (String = "application/openmetrics-text; version=1.0.0; charset=utf-8")))))]
pub(super) async fn metrics(
    State(app): State<Shared>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut registry = Registry::with_prefix("mocapd");
    let figures = Figures { status: app.control.status(), counts: Arc::clone(&app.counts) };
    registry.register_collector(Box::new(figures));
    let mut text = String::new();
    encode(&mut text, &registry).map_err(|error| Problem::internal(error.to_string()))?;
    let accepts = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok());
    let (content_type, text) = if accepts.is_some_and(|types| types.contains(OPEN_METRICS)) {
        ("application/openmetrics-text; version=1.0.0; charset=utf-8", text)
    } else {
        ("text/plain; version=0.0.4; charset=utf-8", classic(&text))
    };
    Ok(([(header::CONTENT_TYPE, content_type)], text).into_response())
}

/// The text as it was before `OpenMetrics`: there a counter's help and type stand under its full name, units are part of
/// the name only, and there is no end. Read the new way by an old reader, counters would have no help.
fn classic(text: &str) -> String {
    let counters: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("# TYPE ")?.strip_suffix(" counter"))
        .collect();
    let mut out = String::with_capacity(text.len());
    for line in text.lines().filter(|line| !line.starts_with("# UNIT ") && *line != "# EOF") {
        let mut words = line.splitn(4, ' ');
        match (words.next(), words.next(), words.next(), words.next()) {
            (Some("#"), Some(what), Some(name), Some(rest)) if counters.contains(&name) => {
                out += &format!("# {what} {name}_total {rest}\n");
            }
            _ => {
                out += line;
                out.push('\n');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::status::{
        DeviceStatus, OutageStatus, State as ServiceState, Status, TakeStatus, TakeSummary,
    };

    fn text(status: Status) -> String {
        let mut registry = Registry::with_prefix("mocapd");
        registry.register_collector(Box::new(Figures { status, counts: Arc::default() }));
        let mut text = String::new();
        encode(&mut text, &registry).unwrap();
        text
    }

    /// Gives every number in a document one that stands nowhere else, and tells where.
    fn number(value: &mut Value, path: &str, numbers: &mut Vec<(String, u64)>) {
        match value {
            Value::Object(fields) => {
                for (name, field) in fields {
                    number(field, &format!("{path}.{name}"), numbers);
                }
            }
            Value::Number(old) => {
                let new = 1_000_003 + 7 * numbers.len() as u64;
                *value = if old.is_f64() { Value::from(new as f64) } else { Value::from(new) };
                numbers.push((path.to_owned(), new));
            }
            _ => {}
        }
    }

    #[test]
    fn every_number_of_the_status_is_a_figure() {
        let outage = OutageStatus { ends_in_s: Some(0.0), ..OutageStatus::default() };
        let full = Status {
            device: DeviceStatus { outage: Some(outage), ..DeviceStatus::default() },
            take: Some(TakeStatus::default()),
            last_take: Some(TakeSummary::default()),
            disk: crate::status::DiskStatus {
                free_bytes: Some(0),
                left_s: Some(0),
                ..Default::default()
            },
            ..Status::default()
        };
        let (mut document, mut numbers) = (serde_json::to_value(full).unwrap(), Vec::new());
        number(&mut document, "status", &mut numbers);
        assert!(numbers.len() > 40, "{numbers:?}");
        let text = text(serde_json::from_value(document).unwrap());
        let values: Vec<f64> = text
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| line.rsplit_once(' ').unwrap().1.parse().unwrap())
            .collect();
        for (path, number) in numbers {
            let in_base_units = [1.0, 1e-3, 1e-6].map(|factor| number as f64 * factor);
            let found = values.iter().any(|value| {
                in_base_units.iter().any(|wanted| (value - wanted).abs() < 1e-9 * wanted)
            });
            assert!(found, "{path} is in no figure");
        }
    }

    #[test]
    fn states_are_one_of_several() {
        let text = text(Status { state: ServiceState::Armed, ..Status::default() });
        assert!(text.contains("mocapd_state{state=\"armed\"} 1.0\n"), "{text}");
        assert!(text.contains("mocapd_state{state=\"recording\"} 0.0\n"), "{text}");
        assert!(!text.contains("mocapd_take_"), "no take, no figures of it");
    }

    #[test]
    fn the_old_form_has_help_for_its_counters() {
        let new = text(Status::default());
        assert!(new.contains("# TYPE mocapd_input_frames counter\n") && new.ends_with("# EOF\n"));
        let old = classic(&new);
        assert!(old.contains("# HELP mocapd_input_frames_total "), "{old}");
        assert!(
            old.contains("# TYPE mocapd_input_frames_total counter\nmocapd_input_frames_total 0\n")
        );
        assert!(!old.contains("# EOF") && !old.contains("# UNIT"));
        let values = |text: &str| text.lines().filter(|line| !line.starts_with('#')).count();
        assert_eq!(values(&old), values(&new));
    }
}
