//! Idempotent requests: a repeated request gets the reply to the first.

use std::{any::Any, collections::VecDeque, sync::Arc};

use mocapd_acquire::pipeline::lock;

use super::Inner;
use crate::control::{Refusal, RefusalKind};

/// Maximum number of replies that are remembered: clients repeat a request within seconds, and none sends hundreds per
/// second.
const REPLIES_MAX: usize = 256;

/// Longest request id in bytes.
const ID_BYTES_MAX: usize = 64;

/// Replies by request id, oldest first.
#[derive(Debug, Default)]
pub(super) struct IdempotentReplies(VecDeque<(String, KnownRequest)>);

/// A request that has been received: its kind and its reply.
#[derive(Debug, Clone)]
struct KnownRequest {
    what: &'static str,
    /// The take that the request is about, if its path names one.
    about: String,
    reply: Reply,
}

#[derive(Debug, Clone)]
enum Reply {
    /// The request is being executed.
    Pending,
    Done(Arc<dyn Any + Send + Sync>),
}

impl Inner {
    /// Executes a request, unless one with its id was received before.
    pub(super) fn once<T: Clone + Send + Sync + 'static>(
        &self,
        what: &'static str,
        id: Option<&str>,
        execute: impl FnOnce(&Self) -> Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        self.once_about((what, ""), id, execute)
    }

    /// Executes a request about a take, unless one with its id was received before.
    pub(super) fn once_about<T: Clone + Send + Sync + 'static>(
        &self,
        (what, about): (&'static str, &str),
        id: Option<&str>,
        execute: impl FnOnce(&Self) -> Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        let Some(id) = id else { return execute(self) };
        let invalid = |message: &str| Refusal::new(RefusalKind::Invalid, message);
        if id.is_empty() || id.len() > ID_BYTES_MAX || id.chars().any(char::is_control) {
            return Err(invalid("a request_id has 1 to 64 bytes and no control characters"));
        }
        if let Some(known) = self.claim((what, about), id) {
            let other = "this request_id was used for a different kind of request";
            if known.what != what || known.about != about {
                return Err(invalid(other));
            }
            let Reply::Done(answer) = known.reply else {
                let message = "this request is still being executed: ask again in a moment";
                return Err(Refusal::unavailable(message));
            };
            let answer = answer.downcast_ref::<Result<T, Refusal>>();
            return answer.cloned().unwrap_or_else(|| Err(invalid(other)));
        }
        let answer = execute(self);
        let mut replies = lock(&self.replies);
        if let Some(at) = replies.0.iter().rposition(|(known, _)| known == id) {
            match &answer {
                // A request that was not executed may be tried again.
                Err(refusal) if refusal.kind == RefusalKind::Unavailable => {
                    replies.0.remove(at);
                }
                _ => replies.0[at].1.reply = Reply::Done(Arc::new(answer.clone())),
            }
        }
        answer
    }

    /// The known request with this id; otherwise registers it as being executed.
    fn claim(&self, (what, about): (&'static str, &str), id: &str) -> Option<KnownRequest> {
        let mut replies = lock(&self.replies);
        if let Some((_, known)) = replies.0.iter().find(|(known, _)| known == id) {
            return Some(known.clone());
        }
        if replies.0.len() == REPLIES_MAX {
            replies.0.pop_front();
        }
        replies.0.push_back((
            id.to_owned(),
            KnownRequest { what, about: about.to_owned(), reply: Reply::Pending },
        ));
        None
    }
}
