//! Frames for people's eyes, as a stream of bytes.

use axum::{
    body::Body,
    extract::State,
    http::{HeaderValue, header},
    response::Response,
};
use futures_util::stream;

use super::{connection::until, problem::Problem, state::Shared};

/// Some thirty frames a second, the newest ones
///
/// A stream of messages, little endian: u32 length of what follows, u8 kind. Kind 1 is JSON: the markers, before the
/// first frame and whenever they change. Kind 2 is a frame: three bytes of zero, u64 row, u64 device ticks, u64
/// arrival in microseconds since 1970, then three f32 a marker in millimetres, NaN where it is not seen. Kind 3 stands
/// behind the frame that it belongs to, where the subject's face is seen: three bytes of zero, then for each axis three
/// f32 that a vertex of the face is multiplied by, and one that is added. A viewer that is too slow misses frames, and
/// never the markers.
#[utoipa::path(get, path = "/v1/live", tag = "streams",
    responses((status = 200, description = "Messages, until the client closes", body = Vec<u8>,
        content_type = "application/octet-stream")))]
pub(super) async fn live(State(app): State<Shared>) -> Result<Response, Problem> {
    let place = app.stream_place()?;
    if app.show.is_over() {
        return Err(Problem::unavailable("the service is stopping: there are no more frames"));
    }
    let viewing = app.show.view();
    let state = (app.stopping.clone(), viewing, place);
    let messages = stream::unfold(state, |(mut stopping, mut viewing, place)| async move {
        let bytes = until(&mut stopping, viewing.next()).await??;
        Some((Ok::<_, std::convert::Infallible>(bytes), (stopping, viewing, place)))
    });
    let mut response = Response::new(Body::from_stream(messages));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    Ok(response)
}
