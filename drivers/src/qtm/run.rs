//! A stream from its start to its end: frames, changes of state, and QTM's own account of loss.

use super::{
    axis::ProducedFrames,
    bodies::{BodyComponent, BodyComponentKind},
    command::{Components, DatagramTarget, StreamRate, StreamRequest},
    frame::{FrameComponent, FrameHeader, MarkerComponent, MarkerComponentKind, read_components},
    host::{EventSink, Fence, QtmHost, SessionState},
    packet::{Event, Packet},
    sampled::SampledComponentKind,
    stream_run::{FrameParts, OpenFrame, StreamRun, VendorLoss},
};
use crate::device::{
    DeviceEvent, EndOfPoses, Frame, LinkBudget, MarkerSample, PoseFrame, residual_10um,
};

/// Components of a frame that the driver requests.
const REQUESTED: [MarkerComponentKind; 2] =
    [MarkerComponentKind::LabelledWithResiduals, MarkerComponentKind::UnlabelledWithResiduals];

/// Notes of one stream; a QTM whose state changes again and again must fill neither the take nor the screen.
const NOTES_MAX: u32 = 64;

/// First frames that wait for the datagram of their bodies, by which it is known that there is one.
const FRAMES_FOR_BODIES: u64 = 16;

/// Ids of labelled markers without a channel: above all that QTM gives to unlabelled ones, which have 32 bits.
const NO_CHANNEL: u64 = 1 << 32;

impl QtmHost {
    /// Requests frames.
    pub(super) fn start_stream(&mut self) {
        let has_bodies = self.bodies.n_bodies() > 0;
        let bodies = has_bodies.then_some(BodyComponentKind::MatricesWithResiduals);
        let request = StreamRequest {
            rate: StreamRate::All,
            datagrams: self.datagram_port.map(|port| DatagramTarget { address: None, port }),
            components: Components::of(&REQUESTED).with_bodies(bodies).with_samples(
                self.sampled.has(false).then_some(SampledComponentKind::Analog),
                self.sampled.has(true).then_some(SampledComponentKind::Force),
            ),
        };
        let produced = ProducedFrames::new(self.hello.rate_millihertz, self.hello.tick_hz);
        self.run = StreamRun { has_bodies, produced, ..StreamRun::default() };
        self.state = SessionState::Streaming;
        self.send(&request.to_string());
        self.send_fence(Fence::Started);
    }

    /// The request for frames was accepted.
    pub(super) fn report_started(&mut self, on_event: EventSink<'_>) {
        if std::mem::replace(&mut self.run.is_reported, true) {
            return;
        }
        on_event(DeviceEvent::Started(LinkBudget {
            needed_bytes_per_s: 0,
            available_bytes_per_s: u64::MAX,
            rate_fits_millihertz: self.hello.rate_millihertz,
        }));
        for remark in std::mem::take(&mut self.remarks) {
            self.note(&remark, on_event);
        }
    }

    pub(super) fn note(&mut self, text: &str, on_event: EventSink<'_>) {
        if self.run.notes < NOTES_MAX {
            self.run.notes += 1;
            on_event(DeviceEvent::Note(text));
        }
    }

    pub(super) fn on_data(&mut self, body: &[u8], on_event: EventSink<'_>) {
        self.report_started(on_event);
        // First as a whole: a damaged frame is not recorded in part.
        let Some(parts) = FrameParts::of(body) else {
            self.counters.messages_damaged += 1;
            return;
        };
        if self.holds(body, parts) {
            self.release_excess(on_event);
        } else {
            self.decode(body, on_event);
        }
    }

    /// Decodes a data packet. One of another frame than the open one waits until that is whole, or a third one begins: networks
    /// reorder datagrams.
    pub(super) fn decode(&mut self, body: &[u8], on_event: EventSink<'_>) {
        let header = FrameHeader::of(body).filter(|_| self.datagram_port.is_some());
        let is_other =
            |run: &StreamRun| header.filter(|it| run.open.is_some_and(|o| o.header != *it));
        let now_ns = self.line.now_ns();
        if let Some(header) = is_other(&self.run) {
            if self.run.next.hold(header, body, now_ns) {
                return;
            }
            self.pass_open(on_event);
            // Nothing waits any more, but the one that waited may be open now.
            if is_other(&self.run).is_some_and(|of| self.run.next.hold(of, body, now_ns)) {
                return;
            }
        }
        self.decode_now(body, on_event);
        if self.run.open.is_none() {
            self.open_next(on_event);
        }
    }

    /// Passes the open frame on, and opens the one of which parts wait.
    pub(super) fn pass_open(&mut self, on_event: EventSink<'_>) {
        self.flush_frame(on_event);
        self.open_next(on_event);
    }

    /// Passes on all frames of which parts have come.
    pub(super) fn pass_all(&mut self, on_event: EventSink<'_>) {
        self.pass_open(on_event);
        self.flush_frame(on_event);
    }

    fn open_next(&mut self, on_event: EventSink<'_>) {
        let Some(since_ns) = self.run.next.since_ns() else { return };
        let mut next = std::mem::take(&mut self.run.next);
        next.parts().for_each(|part| self.decode_now(part, on_event));
        if let Some(open) = &mut self.run.open {
            open.opened_ns = since_ns;
        }
        next.clear();
        self.run.next = next;
    }

    fn decode_now(&mut self, body: &[u8], on_event: EventSink<'_>) {
        let mut n_components = 0;
        let is_lossy = self.datagram_port.is_some();
        let header = read_components(body, &mut |header, component| {
            n_components += 1;
            match component {
                FrameComponent::Markers(markers) => self.on_component(header, &markers, on_event),
                FrameComponent::Bodies(bodies) => self.on_bodies(header, &bodies, on_event),
                FrameComponent::UnreadableBodies => self.run.bodies_unreadable += 1,
                FrameComponent::UnreadableSamples => self.run.samples_unreadable += 1,
                FrameComponent::Samples(samples) => {
                    let way = (header.time_us, is_lossy);
                    // Not requested, and without numbers.
                    if samples.kind.is_single() {
                        return;
                    }
                    let fits = self.sampled.samples(&samples, way, on_event);
                    self.run.samples_left_out += u64::from(!fits) * samples.n_samples as u64;
                }
            }
        });
        // A frame without markers is a frame.
        if let Some(header) = header.filter(|_| n_components == 0) {
            self.open_frame(header, on_event);
        }
        // On the stream a packet is a frame.
        if self.datagram_port.is_none() || self.run.open.is_some_and(|open| open.is_whole()) {
            self.flush_frame(on_event);
        }
    }

    /// Begins the frame, unless it is the open one.
    fn open_frame(&mut self, header: FrameHeader, on_event: EventSink<'_>) {
        if self.run.open.is_some_and(|open| open.header == header) {
            return;
        }
        self.flush_frame(on_event);
        self.samples.clear();
        self.bodies.begin_frame();
        self.unlabelled.begin_frame();
        self.run.open = Some(OpenFrame {
            header,
            opened_ns: self.line.now_ns(),
            has_labelled: false,
            has_unlabelled: false,
            has_bodies: false,
            // A QTM that has bodies and tracks none sends no component of them.
            wants_bodies: self.run.has_bodies
                && (self.run.had_bodies || self.run.frames < FRAMES_FOR_BODIES),
        });
    }

    fn on_bodies(
        &mut self,
        header: FrameHeader,
        bodies: &BodyComponent<'_>,
        on_event: EventSink<'_>,
    ) {
        if !self.run.has_bodies {
            return;
        }
        self.open_frame(header, on_event);
        let Some(open) = &mut self.run.open else { return };
        self.run.had_bodies = true;
        // The same part again, of a datagram that came twice.
        if !std::mem::replace(&mut open.has_bodies, true) && !self.bodies.read(bodies) {
            self.run.bodies_left_out += bodies.n_bodies() as u64;
        }
    }

    fn on_component(
        &mut self,
        header: FrameHeader,
        component: &MarkerComponent<'_>,
        on_event: EventSink<'_>,
    ) {
        let is_labelled = component.kind.is_labelled();
        self.open_frame(header, on_event);
        if let Some(open) = &mut self.run.open {
            let has = if is_labelled { &mut open.has_labelled } else { &mut open.has_unlabelled };
            if std::mem::replace(has, true) {
                // The same part again, of a datagram that came twice.
                return;
            }
        }
        let rates = [component.drop_rate, component.out_of_sync_rate];
        let VendorLoss { worst, frames } = &mut self.run.vendor;
        for ((rate, worst), frames) in rates.into_iter().zip(worst).zip(frames) {
            *worst = rate.max(*worst);
            *frames += u64::from(rate > 0 && is_labelled);
        }
        let fits = component.n_markers() == self.labels.n_labels();
        for (index, marker) in component.markers().enumerate() {
            let is_missing = marker.position_mm.iter().any(|value| value.is_nan());
            let is_finite = marker.position_mm.iter().all(|value| value.is_finite());
            self.counters.samples_not_finite += u64::from(!is_missing && !is_finite);
            let id = if !is_labelled {
                Some(u64::from(marker.id))
            } else if fits && self.labels.id(index).is_some() {
                None
            } else {
                Some(NO_CHANNEL + index as u64)
            };
            let id = match id {
                None => self.labels.id(index),
                Some(_) if !is_finite => continue,
                Some(vendor_id) => self.unlabelled.channel(vendor_id),
            };
            let Some(id) = id else {
                self.run.excess += 1;
                continue;
            };
            self.samples.push(MarkerSample {
                id,
                occluded: !is_finite,
                residual_10um: residual_10um(f64::from(marker.residual_mm)),
                position_mm: if is_finite { marker.position_mm } else { [0.0; 3] },
            });
        }
    }

    /// Passes the open frame on.
    pub(super) fn flush_frame(&mut self, on_event: EventSink<'_>) {
        let Some(open) = self.run.open.take() else { return };
        let header = open.header;
        let count = if open.is_whole() { &mut self.run.whole } else { &mut self.run.partial };
        *count += 1;
        let seq = self.axis.counter(header.number, header.time_us);
        let run = &mut self.run;
        if run.produced.follow(seq, header.time_us) {
            run.last = seq;
        }
        let stated_hz = f64::from(self.hello.rate_millihertz) / 1000.0;
        let measured_hz = run.rate.follow(header.number, header.time_us, stated_hz);
        self.had_frames = true;
        run.last_us = header.time_us;
        run.frames += 1;
        on_event(DeviceEvent::Frame(Frame {
            seq,
            device_ticks: header.time_us,
            timecode: None,
            markers: &self.samples,
        }));
        // Where datagrams are lost, those of the bodies may be. A QTM that tracks no body sends none.
        if run.has_bodies && (open.has_bodies || !open.wants_bodies || self.datagram_port.is_none())
        {
            on_event(DeviceEvent::Poses(PoseFrame {
                seq,
                number: seq,
                device_ticks: header.time_us,
                poses: self.bodies.poses(),
            }));
        }
        if let Some(hz) = measured_hz {
            // Not among the notes that are counted: there is one, and it matters.
            on_event(DeviceEvent::Note(&format!(
                "QTM's frame rate is {hz:.1} Hz by its clock, and was stated as {stated_hz} Hz: lengths and times that \
                 follow from the rate are wrong; stop, and record again"
            )));
        }
    }

    pub(super) fn on_state_change(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        let event = packet.body.first().and_then(|code| Event::of(*code));
        self.counters.messages_unknown += u64::from(event.is_none());
        match event {
            Some(Event::RtFromFileStarted) => self.plays_file = true,
            Some(Event::Connected | Event::ConnectionClosed) => self.plays_file = false,
            _ => {}
        }
        match self.state {
            SessionState::BringUp(_) => self.on_state_reply(),
            SessionState::Streaming => {
                let Some(event) = event else { return };
                self.note(&format!("QTM: {}", event.name()), on_event);
                let has_frames = self.run.frames > 0;
                match event {
                    Event::RtFromFileStopped if has_frames => self.begin_end(),
                    Event::ConnectionClosed if has_frames => self.end_measurement(event.name()),
                    Event::ShuttingDown => self.lose("QTM shuts down".to_owned()),
                    Event::CameraSettingsChanged => self.renew_all(),
                    _ => {}
                }
            }
            // A datagram may have told of the end before this did.
            SessionState::Ending(_) => {
                if let Some(event) = event {
                    self.note(&format!("QTM: {}", event.name()), on_event);
                }
            }
            SessionState::Off | SessionState::Over | SessionState::Ready => {}
        }
    }

    pub(super) fn on_no_more_data(&mut self, on_event: EventSink<'_>) {
        self.report_started(on_event);
        if self.run.frames == 0 {
            self.note_idle(on_event);
        } else if self.plays_file {
            self.begin_end();
        } else {
            self.end_measurement("no more data");
        }
    }

    /// Explains, once, why QTM answers and no frame has come.
    pub(super) fn note_idle(&mut self, on_event: EventSink<'_>) {
        if self.run.frames > 0 || std::mem::replace(&mut self.run.is_idle_noted, true) {
            return;
        }
        let text = match self.datagram_port {
            None => "QTM answers, but no measurement is running: frames come as soon as one starts"
                .to_owned(),
            Some(port) => format!(
                "QTM answers, but no datagram has come: either no measurement is running, or a firewall blocks UDP \
                 port {port}; without ?transport=udp frames come by TCP"
            ),
        };
        self.note(&text, on_event);
    }

    /// A live measurement is over. The recorder waits for the next, as for a device that was switched off.
    fn end_measurement(&mut self, how: &str) {
        self.lose(format!("QTM's measurement is over ({how})"));
    }

    /// The stream has ended, and all that belongs to it has arrived.
    pub(super) fn end(&mut self, on_event: EventSink<'_>) {
        self.release_held(on_event);
        self.pass_all(on_event);
        self.state = SessionState::Ready;
        self.fence = None;
        let VendorLoss { worst, frames } = self.run.vendor;
        let texts = [
            "2D frames lost between cameras and QTM",
            "2D frames out of step with those of other cameras",
        ];
        for ((worst, frames), what) in worst.into_iter().zip(frames).zip(texts) {
            if worst > 0 {
                let text = format!(
                    "QTM's own account: up to {worst} per thousand {what}, in {frames} frames"
                );
                on_event(DeviceEvent::Note(&text));
            }
        }
        self.note_what_is_missing(on_event);
        if self.run.has_bodies && self.run.frames > 0 {
            let (seq, device_ticks) = (self.run.last.wrapping_add(1), self.run.last_us);
            on_event(DeviceEvent::EndOfPoses(EndOfPoses { seq, number: seq, device_ticks }));
        }
        on_event(DeviceEvent::EndOfStream(self.run.status()));
    }

    /// Reports what came and could not be recorded.
    fn note_what_is_missing(&self, on_event: EventSink<'_>) {
        let run = &self.run;
        let is_divided = run.whole > 0 && self.datagram_port.is_some();
        let counts = [
            (
                if is_divided { run.partial } else { 0 },
                "frames are incomplete: datagrams with some of their markers or bodies were lost",
            ),
            (
                run.samples_unreadable,
                "components of analog samples or forces cannot be read: their layout is not the documented one",
            ),
            (
                run.samples_left_out,
                "analog samples or forces were left out: their device was not in QTM's settings, or had other channels",
            ),
            (
                run.bodies_unreadable,
                "components of rigid bodies cannot be read: their layout is not the documented one",
            ),
            (
                run.bodies_left_out,
                "poses were left out: their frames have another number of bodies than QTM's settings",
            ),
            (run.excess, "unlabelled samples were left out: too many at once"),
        ];
        for (count, what) in counts {
            if count > 0 {
                on_event(DeviceEvent::Note(&format!("{count} {what}")));
            }
        }
    }
}
