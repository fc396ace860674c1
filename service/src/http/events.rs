//! What happens, as server-sent events.

use std::convert::Infallible;

use axum::{
    extract::{Query, State, rejection::QueryRejection},
    http::{HeaderMap, HeaderName},
    response::sse::{Event, KeepAlive, Sse},
};
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    connection::until,
    happenings::{Following, Told},
    problem::Problem,
    state::{Shared, StreamPlace},
};
use crate::status::ServiceEvent;

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

#[derive(Debug, Deserialize)]
pub(super) struct After {
    after: Option<u64>,
}

/// Events that are gone: the listener was too slow, or away for too long.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Missed {
    /// How many; null where the service was started anew meanwhile, and nobody knows.
    missed: Option<u64>,
}

/// What happens, as it happens
///
/// Server-sent events: `event` is the kind, `data` the event in JSON, `id` its number in this run of the service. With
/// `Last-Event-ID` it goes on where that one was, as far as events are kept. What is missing is told by an event
/// `missed`.
#[utoipa::path(get, path = "/v1/events", tag = "streams",
    params(("after" = Option<u64>, Query, description =
            "Begin behind the event of this number, as far back as is kept; 0 for all of them"),
        ("Last-Event-ID" = Option<String>, Header, description = "The last id that was seen")),
    responses((status = 200, description = "Events, until the client closes", body = ServiceEvent,
        content_type = "text/event-stream")))]
pub(super) async fn events(
    State(app): State<Shared>,
    after: Result<Query<After>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let Query(After { after }) =
        after.map_err(|_| Problem::invalid("`after` is the number of an event"))?;
    let resumed =
        headers.get(LAST_EVENT_ID).and_then(|id| resume(id.to_str().ok()?, &app.happenings.run));
    let (after, anew) = match resumed {
        Some(Resumed::At(number)) => (Some(number), false),
        Some(Resumed::Anew) => (Some(0), true),
        None => (after, false),
    };
    let following = app.happenings.follow(after);
    let place = app.stream_place()?;
    let keep_alive = KeepAlive::new().interval(app.limits.keep_alive);
    let listener = Listener { app, following, pending: None, anew, _place: place };
    Ok(Sse::new(stream::unfold(listener, Listener::next)).keep_alive(keep_alive))
}

#[derive(Debug, PartialEq, Eq)]
enum Resumed {
    /// In this run of the service.
    At(u64),
    /// In another one, or nobody knows where.
    Anew,
}

/// An id is `RUN-NUMBER`; a bare number means this run.
fn resume(id: &str, run: &str) -> Option<Resumed> {
    let id = id.trim();
    if id.is_empty() {
        return None;
    }
    let (of, number) = id.rsplit_once('-').unwrap_or((run, id));
    Some(match number.parse() {
        Ok(number) if of == run => Resumed::At(number),
        _ => Resumed::Anew,
    })
}

struct Listener {
    app: Shared,
    following: Following,
    pending: Option<Told>,
    /// It has to be told first that this is another run.
    anew: bool,
    _place: StreamPlace,
}

impl Listener {
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        if std::mem::take(&mut self.anew) {
            return Some((Ok(missed(None)), self));
        }
        let told = match self.pending.take() {
            Some(told) => told,
            None => {
                let mut stopping = self.app.stopping.clone();
                until(&mut stopping, self.following.next()).await??
            }
        };
        if told.missed > 0 {
            let event = missed(Some(told.missed));
            self.pending = Some(Told { missed: 0, ..told });
            return Some((Ok(event), self));
        }
        let id = format!("{}-{}", self.app.happenings.run, told.event.number);
        // Strings and numbers are always JSON, on one line.
        let data = serde_json::to_string(told.event.as_ref()).unwrap_or_default();
        let kind = told.event.kind.to_string();
        Some((Ok(Event::default().id(id).event(kind).data(data)), self))
    }
}

fn missed(missed: Option<u64>) -> Event {
    let data = serde_json::to_string(&Missed { missed }).unwrap_or_default();
    Event::default().event("missed").data(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_of_this_run_and_of_others() {
        assert_eq!(resume("18f-7", "18f"), Some(Resumed::At(7)));
        assert_eq!(resume(" 7 ", "18f"), Some(Resumed::At(7)));
        assert_eq!(resume("", "18f"), None);
        for id in ["17a-7", "18f-", "18f-x", "x", "18f--1"] {
            assert_eq!(resume(id, "18f"), Some(Resumed::Anew), "{id}");
        }
    }
}
