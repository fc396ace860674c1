//! Replies that continue until the client closes: events as server-sent events, and live frames.

use std::convert::Infallible;

use axum::{
    body::Body,
    extract::{Query, State, rejection::QueryRejection},
    http::{HeaderMap, HeaderName, header},
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
};
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    Shared, StreamPermit,
    body::Problem,
    broadcast::{Delivery, EventSubscription},
    until,
};
use crate::status::ServiceEvent;

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

#[derive(Debug, Deserialize)]
pub(super) struct After {
    after: Option<u64>,
}

/// Reports lost events: the client was too slow, or was away for too long.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Missed {
    /// Number of lost events; null if it is unknown because the service was restarted.
    missed: Option<u64>,
}

/// Events as they happen
///
/// Server-sent events: `event` is the kind, `data` the event in JSON, and `id` its number in this run of the service.
/// With `Last-Event-ID` the stream continues after that event, as far back as events are kept. An event `missed`
/// reports lost events.
#[utoipa::path(get, path = "/v1/events", tag = "streams",
    params(("after" = Option<u64>, Query, description =
            "Start after the event with this number, as far back as events are kept; 0 for all of them"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event received")),
    responses((status = 200, description = "Events, until the client closes", body = ServiceEvent,
        content_type = "text/event-stream")))]
pub(super) async fn events(
    State(app): State<Shared>,
    after: Result<Query<After>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let Query(After { after }) =
        after.map_err(|_| Problem::invalid("`after` must be the number of an event"))?;
    let resumed =
        headers.get(LAST_EVENT_ID).and_then(|id| resume(id.to_str().ok()?, &app.events.run));
    let (after, is_other_run) = match resumed {
        Some(Resumed::At(number)) => (Some(number), false),
        Some(Resumed::OtherRun) => (Some(0), true),
        None => (after, false),
    };
    let subscription = app.events.follow(after);
    let _permit = app.stream_permit()?;
    let keep_alive = KeepAlive::new().interval(app.limits.keep_alive);
    let events = EventStream { app, subscription, pending: None, is_other_run, _permit };
    Ok(Sse::new(stream::unfold(events, EventStream::next)).keep_alive(keep_alive))
}

#[derive(Debug, PartialEq, Eq)]
enum Resumed {
    /// After this event of the current run.
    At(u64),
    /// After an event of another run, or an unknown one.
    OtherRun,
}

/// Parses an id `RUN-NUMBER`; a bare number refers to the current run.
fn resume(id: &str, run: &str) -> Option<Resumed> {
    let id = id.trim();
    if id.is_empty() {
        return None;
    }
    let (of, number) = id.rsplit_once('-').unwrap_or((run, id));
    Some(match number.parse() {
        Ok(number) if of == run => Resumed::At(number),
        _ => Resumed::OtherRun,
    })
}

struct EventStream {
    app: Shared,
    subscription: EventSubscription,
    pending: Option<Delivery>,
    /// Whether the client must first be informed that this is another run.
    is_other_run: bool,
    _permit: StreamPermit,
}

impl EventStream {
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        if std::mem::take(&mut self.is_other_run) {
            return Some((Ok(missed(None)), self));
        }
        let delivery = match self.pending.take() {
            Some(delivery) => delivery,
            None => {
                let mut stopping = self.app.stopping.clone();
                until(&mut stopping, self.subscription.next()).await??
            }
        };
        if delivery.missed > 0 {
            let event = missed(Some(delivery.missed));
            self.pending = Some(Delivery { missed: 0, ..delivery });
            return Some((Ok(event), self));
        }
        let id = format!("{}-{}", self.app.events.run, delivery.event.number);
        // Strings and numbers can always be written as JSON, on one line.
        let data = serde_json::to_string(delivery.event.as_ref()).unwrap_or_default();
        let kind = delivery.event.kind.to_string();
        Some((Ok(Event::default().id(id).event(kind).data(data)), self))
    }
}

fn missed(missed: Option<u64>) -> Event {
    let data = serde_json::to_string(&Missed { missed }).unwrap_or_default();
    Event::default().event("missed").data(data)
}

/// The newest live frames, some thirty a second
///
/// A stream of messages, little endian: u32 length of what follows, u8 kind. Kind 1 is the table of markers in JSON,
/// sent before the first frame and whenever the markers change. Kind 2 is a frame: three zero bytes, u64 row, u64
/// device ticks, u64 arrival in microseconds since 1970, then three f32 per marker in millimetres, NaN if it is not
/// seen. Kind 3 follows the frame that it belongs to if the subject's face is seen: three zero bytes, then for each
/// axis three f32 factors of a vertex of the face, and one f32 offset. Kind 4 follows the next frame, a column of a strip
/// chart of a group of sampled channels: u8 index of the group in the table, two zero bytes, u64 number of its first sample,
/// u32 number of samples, then for each channel its least and its largest value as f32. A slow viewer misses frames, but
/// never the table.
#[utoipa::path(get, path = "/v1/live", tag = "streams",
    responses((status = 200, description = "Messages, until the client closes", body = Vec<u8>,
        content_type = "application/octet-stream")))]
pub(super) async fn live(State(app): State<Shared>) -> Result<Response, Problem> {
    let permit = app.stream_permit()?;
    if app.live.is_over() {
        return Err(Problem::unavailable("the service is stopping: there are no more live frames"));
    }
    let subscription = app.live.view();
    let state = (app.stopping.clone(), subscription, permit);
    let messages = stream::unfold(state, |(mut stopping, mut subscription, permit)| async move {
        let bytes = until(&mut stopping, subscription.next()).await??;
        Some((Ok::<_, Infallible>(bytes), (stopping, subscription, permit)))
    });
    let content_type = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((content_type, Body::from_stream(messages)).into_response())
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
            assert_eq!(resume(id, "18f"), Some(Resumed::OtherRun), "{id}");
        }
    }
}
