//! What is done at a boundary between two stretches: takes end, begin, and are saved.

use std::sync::{Arc, atomic::Ordering};

use anyhow::anyhow;
use mocapd_take::record::{Channel, EndingKind};

use super::{TakeOutput, Writer, clocks::ClockWriter, live::LiveTake};
use crate::{
    files::FileState,
    pipeline::{
        Progress, lock,
        messages::StretchEnd,
        takes::{Answers, NewTake, TakeFailed, What},
    },
};

impl<W: TakeOutput> Writer<W> {
    /// Everything that was ordered up to this boundary.
    pub(super) fn carry_out(&mut self, boundary: u64, end: &StretchEnd) {
        self.observe();
        while let Some(order) = self.next_order.take().or_else(|| self.orders.try_recv().ok()) {
            if order.boundary > boundary {
                // It came while the writer was here: its boundary is on the way.
                self.next_order = Some(order);
                return;
            }
            match order.what {
                What::End(ending) => self.end_take(ending),
                What::Begin(take, answers) => {
                    self.end_take(EndingKind::Stopped);
                    let progress = Arc::clone(&self.progress);
                    let mut clocks = std::mem::replace(&mut self.clocks, ClockWriter::idle());
                    clocks.begin();
                    let asked_ns = take.asked_ns;
                    self.live = self.begin_take(*take, answers, end, &mut clocks, &progress);
                    self.clocks = clocks;
                    self.on_take(|take, _| take.asked_here(end.span.first_row, asked_ns));
                }
                What::Save(take, answers) => {
                    // The take that is being written goes on beside it, and what others look at is that one's.
                    let (mut clocks, progress) = (self.clocks.beside(), Progress::new(&[]));
                    let saved = self.begin_take(*take, answers, end, &mut clocks, &progress);
                    if let Some(saved) = saved {
                        let ending = EndingKind::Saved.into();
                        saved.end(&self.counts.in_rows(), &mut clocks, ending);
                    }
                }
            }
        }
    }

    fn end_take(&mut self, ending: EndingKind) {
        if let Some(take) = self.live.take() {
            take.end(&self.counts.in_rows(), &mut self.clocks, ending.into());
        }
        *lock(&self.progress.take) = None;
    }

    /// A take that has what is held of the last `pre_roll`. What failed is told to whoever waits for it.
    fn begin_take(
        &self,
        new: NewTake<W>,
        answers: Answers<W>,
        end: &StretchEnd,
        clocks: &mut ClockWriter,
        progress: &Progress,
    ) -> Option<LiveTake<W>> {
        let NewTake { output, mut header, subject, pre_roll, asked_ns, notes, keep_free_bytes } =
            new;
        let from = self.held.as_ref().map_or(0, |held| held.of_last(pre_roll, asked_ns));
        let first = self.held.as_ref().and_then(|held| held.from(from).next());
        let (base, rows_before, stretch) = match first {
            // The row after the stretch before: rows lost before it are its own.
            Some(held) => (held.before.in_rows(), held.before.in_rows().seen(), held.stretch),
            None => (self.counts.in_rows(), end.span.first_row, u64::MAX),
        };
        let known = |(since, _): &&(u64, Channel)| *since <= stretch;
        // Its first row is older than the wish for it.
        let before_ns = first.map_or(0, |held| asked_ns.saturating_sub(held.first.arrival_ns));
        header.created_unix_ms -= (before_ns / 1_000_000).cast_signed();
        header.channels = self.table.iter().filter(known).map(|(_, c)| c.clone()).collect();
        progress.disk_full.store(false, Ordering::Relaxed);
        progress.set_file_state(FileState::InPlace, None);
        let times = (self.sync_every, keep_free_bytes);
        let opening = (&header, subject.as_deref());
        let begun = LiveTake::begin(output, opening, answers, (base, rows_before), times);
        let mut take = match begun {
            Ok(take) => take,
            Err((error, answers)) => {
                answers.ended.try_send(Err(TakeFailed::without_output(error))).ok();
                return None;
            }
        };
        take.reserve(self.payload.capacity());
        let wrote = notes.map_or(Ok(()), |event| take.event(&event));
        let held =
            wrote.and_then(|()| self.write_held(&mut take, (from, stretch), clocks, progress));
        match held {
            Ok(()) => Some(take),
            Err(error) => {
                take.give_up(error);
                None
            }
        }
    }

    fn write_held(
        &self,
        take: &mut LiveTake<W>,
        (from, first): (usize, u64),
        clocks: &mut ClockWriter,
        progress: &Progress,
    ) -> anyhow::Result<()> {
        take.look_at_disk(progress);
        let Some(held) = &self.held else { return Ok(()) };
        if first == u64::MAX {
            return Ok(());
        }
        let mut channels = self.table.iter().filter(|(since, _)| *since > first).peekable();
        let mut events = held.events().filter(|(stretch, _)| *stretch >= first).peekable();
        for stretch in held.from(from) {
            if progress.disk_full.load(Ordering::Relaxed) {
                return Err(anyhow!("the disk is full: delete something"));
            }
            while let Some((_, channel)) = channels.next_if(|(since, _)| *since <= stretch.stretch)
            {
                take.channel(channel)?;
            }
            while let Some((_, event)) = events.next_if(|(at, _)| *at <= stretch.stretch) {
                take.event(event)?;
            }
            let (payload, report) = (&stretch.payload, &stretch.report);
            take.stretch(stretch.span, stretch.first, payload, report, &stretch.after)?;
        }
        channels.try_for_each(|(_, channel)| take.channel(channel))?;
        events.try_for_each(|(_, event)| take.event(event))?;
        take.ledger_and_sync(clocks, progress)?;
        take.tell(progress);
        Ok(())
    }
}
