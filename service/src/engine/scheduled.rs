//! Starts a take at a time of day. The start waits on a thread of its own, and is then executed as any other command.

use std::{
    sync::{Arc, PoisonError},
    time::Duration,
};

use jiff::{SignedDuration, ToSpan, Zoned, civil::Time, tz::AmbiguousOffset};

use super::{
    Inner,
    session::{ScheduledStart, unix_ms},
};
use crate::{
    control::{Refusal, RefusalKind, Request, Start},
    status::{PendingStart, ServiceEventKind},
    units::local_time,
};

/// How far away a start may be: the next time of day that is not ambiguous.
const AHEAD_MAX: SignedDuration = SignedDuration::from_hours(24);

/// A start on the next day that is further away was probably meant for today.
const PROBABLY_MISSED: SignedDuration = SignedDuration::from_hours(12);

/// How late a start may be executed, because the machine slept, its clock was set, or another command took long: the
/// motion that it was meant for has begun by then.
const LATE_MAX_MS: i64 = 5000;

/// Longest wait before the clock is looked at again: it may be set.
const STEP_MAX: Duration = Duration::from_millis(500);

/// Executes scheduled starts until the service stops.
pub(super) fn run(inner: &Arc<Inner>) {
    loop {
        let core = inner.core();
        // Looked at under the lock: the end of the service takes it before it notifies.
        if inner.is_stopping() {
            return;
        }
        let Some(due_ms) = core.scheduled.as_ref().map(|it| it.pending.at_unix_ms) else {
            // Every schedule notifies.
            drop(inner.changed.wait(core));
            continue;
        };
        let left_ms = due_ms.saturating_sub(unix_ms());
        if left_ms > 0 {
            let wait = Duration::from_millis(left_ms.unsigned_abs()).min(STEP_MAX);
            let waited = inner.changed.wait_timeout(core, wait);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
            continue;
        }
        drop(core);
        inner.start_scheduled();
    }
}

impl Inner {
    /// Has a take started at a time of day.
    pub(super) fn schedule_start(&self, start: &Start) -> Result<PendingStart, Refusal> {
        let text = start.at.as_deref().unwrap_or_default();
        let now = Zoned::now();
        let at = next_occurrence(text, &now)?;
        let at_unix_ms = at.timestamp().as_millisecond();
        self.check_start(start)?;
        let mut remarks = Vec::new();
        if at.date() != now.date() && at.duration_since(&now) > PROBABLY_MISSED {
            remarks.push(format!(
                "this is tomorrow, because today it is past {text}: cancel it if today was meant"
            ));
        }
        let mut core = self.core();
        if self.is_stopping() {
            return Err(Refusal::unavailable("the service is stopping"));
        }
        if let Some(waiting) = &core.scheduled {
            return Err(already_waits(&waiting.pending));
        }
        if core.session.is_none() {
            remarks.push("the rig is not armed yet: it has to be at that time".to_owned());
        }
        let pending = PendingStart {
            at_unix_ms,
            at: local_time(at_unix_ms).unwrap_or_default(),
            name: start.name.clone(),
            remarks,
        };
        let start = Start { at: None, request_id: None, ..start.clone() };
        core.scheduled = Some(ScheduledStart { start, pending: pending.clone() });
        core.missed_start = None;
        drop(core);
        self.changed.notify_all();
        let message = format!("a take will be started at {}", pending.at);
        self.publish(ServiceEventKind::State, &message, None);
        Ok(pending)
    }

    /// Cancels the start that waits.
    pub(super) fn cancel_start(&self, _request: &Request) -> Result<PendingStart, Refusal> {
        let mut core = self.core();
        core.missed_start = None;
        let cancelled = core.scheduled.take();
        drop(core);
        let Some(ScheduledStart { pending, .. }) = cancelled else {
            return Err(Refusal::conflict("no start is waiting: there is nothing to cancel"));
        };
        self.changed.notify_all();
        let message = format!("the start at {} was cancelled", pending.at);
        self.publish(ServiceEventKind::State, &message, None);
        Ok(pending)
    }

    /// Executes the start whose time has come. A failure is an event, and in the status.
    fn start_scheduled(&self) {
        let command = self.command();
        // It may have been cancelled while another command was executed, and another one scheduled, or the clock set back.
        let is_due = |it: &mut ScheduledStart| it.pending.at_unix_ms <= unix_ms();
        let Some(due) = self.core().scheduled.take_if(is_due) else { return };
        let at = &due.pending.at;
        let late_ms = unix_ms().saturating_sub(due.pending.at_unix_ms);
        let is_armed = self.core().session.is_some();
        let started = match command {
            Err(refusal) => Err(refusal),
            Ok(_) if late_ms > LATE_MAX_MS => Err(Refusal::conflict(format!(
                "its time had passed by {:.1} s: the machine slept, its clock was set, or another command took long",
                late_ms as f64 / 1e3
            ))),
            Ok(_) if !is_armed => Err(Refusal::device("the rig was not armed: arm it before")),
            Ok(command) => self.start_take(&command, &due.start),
        };
        if let Err(refusal) = started {
            let message = format!("the start at {at} did not take place: {}", refusal.message);
            self.core().missed_start = Some(message.clone());
            self.changed.notify_all();
            self.publish(ServiceEventKind::Failure, &message, None);
        }
    }

    /// The service stops: says that a start will not take place.
    pub(super) fn drop_scheduled(&self) {
        let dropped = self.core().scheduled.take();
        if let Some(ScheduledStart { pending, .. }) = dropped {
            let message = format!("the start at {} is cancelled: the service stops", pending.at);
            self.publish(ServiceEventKind::Warning, &message, None);
        }
    }
}

fn already_waits(pending: &PendingStart) -> Refusal {
    Refusal::conflict(format!("a start already waits for {}: cancel it first", pending.at))
}

/// The next time that the clock shows `text`, today or tomorrow.
fn next_occurrence(text: &str, now: &Zoned) -> Result<Zoned, Refusal> {
    let invalid = |message: String| Refusal::new(RefusalKind::Invalid, message);
    let not_a_time =
        || invalid(format!("{text:?} is not a time: write HH:MM or HH:MM:SS, such as 14:05"));
    let time = time_of(text).ok_or_else(not_a_time)?;
    let today = now.datetime();
    let is_past = time <= today.time();
    let day = if is_past { today.date().checked_add(1.day()) } else { Ok(today.date()) };
    let wanted = day.map_err(|_| not_a_time())?.to_datetime(time);
    let found = now.time_zone().to_ambiguous_zoned(wanted);
    let why = match found.offset() {
        AmbiguousOffset::Unambiguous { .. } => None,
        AmbiguousOffset::Gap { .. } => Some("does not exist"),
        AmbiguousOffset::Fold { .. } => Some("comes twice"),
    };
    if let Some(why) = why {
        let message = format!(
            "the time {time} on {} {why}, because the clocks change: choose another time",
            wanted.date()
        );
        return Err(invalid(message));
    }
    let at = found.unambiguous().map_err(|error| invalid(error.to_string()))?;
    if at.duration_since(now) > AHEAD_MAX {
        let message = format!(
            "the time {time} is more than a day away, because the clocks change: choose another time"
        );
        return Err(invalid(message));
    }
    Ok(at)
}

/// A time of day as `HH:MM`, `H:MM` or either with `:SS`, and nothing else.
fn time_of(text: &str) -> Option<Time> {
    let mut parts = text.split(':').enumerate().map(|(index, part)| {
        let has_its_digits = part.len() == 2 || index == 0 && part.len() == 1;
        let is_number = has_its_digits && part.bytes().all(|byte| byte.is_ascii_digit());
        part.parse::<i8>().ok().filter(|_| is_number)
    });
    let (hour, minute) = (parts.next()??, parts.next()??);
    let second = parts.next().unwrap_or(Some(0))?;
    if parts.next().is_some() {
        return None;
    }
    Time::new(hour, minute, second, 0).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn next(text: &str, now: &str) -> Result<String, Refusal> {
        let now: Zoned = now.parse().unwrap();
        next_occurrence(text, &now).map(|at| at.strftime("%Y-%m-%dT%H:%M:%S%:z").to_string())
    }

    #[test]
    fn a_time_of_day_is_today_or_tomorrow() {
        let now = "2026-11-22T14:05:09.5+01:00[Europe/Berlin]";
        assert_eq!(next("14:05:10", now).unwrap(), "2026-11-22T14:05:10+01:00");
        assert_eq!(next("23:59", now).unwrap(), "2026-11-22T23:59:00+01:00");
        assert_eq!(next("9:05", now).unwrap(), "2026-11-23T09:05:00+01:00");
        assert_eq!(next("14:05:09", now).unwrap(), "2026-11-23T14:05:09+01:00");
        assert_eq!(next("00:00:00", now).unwrap(), "2026-11-23T00:00:00+01:00");
        for text in [
            "",
            "14",
            "24:00",
            "14:60",
            "14:05:60",
            "2:5",
            "014:05",
            "14:05:09.5",
            "14:05:09:01",
            "+1:05",
            "14:-5",
            " 14:05",
            "14:05 ",
            "１４:05",
            "now",
            "2026-11-22T14:05:10",
        ] {
            assert_eq!(next(text, now).unwrap_err().kind, RefusalKind::Invalid, "{text}");
        }
    }

    #[test]
    fn times_that_the_clock_shows_twice_or_never_are_refused() {
        let before_spring = "2026-03-28T22:00:00+01:00[Europe/Berlin]";
        let gap = next("02:30", before_spring).unwrap_err();
        assert!(gap.message.contains("does not exist"), "{gap}");
        assert_eq!(next("03:00", before_spring).unwrap(), "2026-03-29T03:00:00+02:00");
        let before_autumn = "2026-10-24T22:00:00+02:00[Europe/Berlin]";
        let fold = next("02:30", before_autumn).unwrap_err();
        assert!(fold.message.contains("comes twice"), "{fold}");
        assert_eq!(next("03:00", before_autumn).unwrap(), "2026-10-25T03:00:00+01:00");
        // The same time tomorrow is 25 hours away.
        let far = next("22:00", before_autumn).unwrap_err();
        assert!(far.message.contains("more than a day"), "{far}");
    }
}
