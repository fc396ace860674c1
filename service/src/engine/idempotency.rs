//! Requests that come twice get the answer of the first time.

use std::{any::Any, collections::VecDeque, sync::Arc};

use mocapd_acquire::pipeline::lock;

use super::Inner;
use crate::control::{Refusal, RefusalKind};

/// Answers that are remembered: a client repeats a request within seconds, and nobody asks hundreds of times a second.
const REPLIES_MAX: usize = 256;

/// Longest id of a request, in bytes.
const ID_BYTES_MAX: usize = 64;

/// By request id, oldest first.
#[derive(Debug, Default)]
pub(super) struct IdempotentReplies(VecDeque<(String, Known)>);

/// A request: what it asks for, and its answer.
#[derive(Debug, Clone)]
struct Known {
    what: &'static str,
    slot: Slot,
}

#[derive(Debug, Clone)]
enum Slot {
    /// It is being carried out.
    Open,
    Answered(Arc<dyn Any + Send + Sync>),
}

impl Inner {
    /// Carries out a request, unless one of its id was already.
    pub(super) fn once<T: Clone + Send + Sync + 'static>(
        &self,
        what: &'static str,
        id: Option<&str>,
        carry_out: impl FnOnce(&Self) -> Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        let Some(id) = id else { return carry_out(self) };
        let invalid = |message: &str| Refusal::new(RefusalKind::Invalid, message);
        if id.is_empty() || id.len() > ID_BYTES_MAX || id.chars().any(char::is_control) {
            return Err(invalid("a request_id has 1 to 64 bytes and no control characters"));
        }
        if let Some(known) = self.claim(what, id) {
            let other = "this request_id was used for another kind of request";
            if known.what != what {
                return Err(invalid(other));
            }
            let Slot::Answered(answer) = known.slot else {
                let message = "the same request is being carried out: ask again in a moment";
                return Err(Refusal::new(RefusalKind::Unavailable, message));
            };
            let answer = answer.downcast_ref::<Result<T, Refusal>>();
            return answer.cloned().unwrap_or_else(|| Err(invalid(other)));
        }
        let answer = carry_out(self);
        let mut replies = lock(&self.replies);
        let at = replies.0.iter().rposition(|(known, _)| known == id);
        if let Some(at) = at {
            match &answer {
                // What was not tried can be tried again.
                Err(refusal) if refusal.kind == RefusalKind::Unavailable => {
                    replies.0.remove(at);
                }
                _ => replies.0[at].1.slot = Slot::Answered(Arc::new(answer.clone())),
            }
        }
        answer
    }

    /// What is known of a request; of one that is new, it is known from now on that it is carried out.
    fn claim(&self, what: &'static str, id: &str) -> Option<Known> {
        let mut replies = lock(&self.replies);
        if let Some((_, known)) = replies.0.iter().find(|(known, _)| known == id) {
            return Some(known.clone());
        }
        if replies.0.len() == REPLIES_MAX {
            replies.0.pop_front();
        }
        replies.0.push_back((id.to_owned(), Known { what, slot: Slot::Open }));
        None
    }
}
