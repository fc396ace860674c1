//! A stream from its start to its end: its state, frames, samples, and definitions that change.

use super::{
    DATA_PORT, Events, MS, NO_FRAMES_NS, NatNetHost, REPEAT_NS,
    assets::{MarkerNames, is_labelled},
    frame::{FrameOfData, MODEL_FILLED, MODELS_CHANGED, NatNetMarker, OCCLUDED, in_mm},
    message::{Bitstream, Message, MessageKind},
};
use crate::{
    axis::ProducedFrames,
    device::{
        DeviceEvent, EndOfPoses, Frame, Hello, LinkBudget, MarkerSample, PoseFrame, Status,
        residual_10um,
    },
    transport::{DatagramSource, polled::LineCommand},
};

/// Notes of one stream: a server that keeps changing must fill neither the take nor the screen.
const NOTES_MAX: u32 = 64;

/// Least time between two requests for the definitions of one stream.
const MODEL_INTERVAL_NS: u64 = 1_000 * MS;

/// How long frames wait for definitions that changed, and how many: a quarter of a second at 240 Hz, and many times what a
/// request takes on a local network.
const MODEL_WAIT_NS: u64 = REPEAT_NS;
const HELD_MAX: usize = 64;

/// Without a frame for so long, frames may come to another port, or not at all.
const IDLE_NS: u64 = 1_000 * MS;

/// Frames of an unknown layout in a row, after which the session is given up.
const MISFITS_MAX: u64 = 16;

/// Frames whose sets are searched for the markers of assets without a name, until other definitions come: some seconds, in
/// which every marker is seen.
const SEARCHES_MAX: u32 = 512;

/// Ids of markers with an asset, but without a label: above all that unlabelled ones have.
const NO_LABEL: u64 = 1 << 32;

/// Ids of markers of which only positions are sent, by their places.
const BY_PLACE: u64 = 1 << 33;

/// The frame counter in the middle of all: the device may begin again at a lower one.
const INDEX_BASE: u64 = 1 << 40;

impl NatNetHost {
    /// Frames come from now on.
    pub(super) fn report_started(&mut self, on_event: Events<'_>) {
        self.run.last_frame_ns = self.line.now_ns();
        on_event(DeviceEvent::Started(LinkBudget {
            needed_bytes_per_s: 0,
            available_bytes_per_s: u64::MAX,
            rate_fits_millihertz: self.hello.rate_millihertz,
        }));
        self.pass_remarks(on_event);
    }

    fn pass_remarks(&mut self, on_event: Events<'_>) {
        for remark in std::mem::take(&mut self.remarks) {
            self.note(&remark, on_event);
        }
    }

    pub(super) fn note(&mut self, text: &str, on_event: Events<'_>) {
        if self.run.notes < NOTES_MAX {
            self.run.notes += 1;
            on_event(DeviceEvent::Note(text));
        }
    }

    /// Reads a frame in the layout that is in use, or in another one that fits, which is in use from then on.
    pub(super) fn read_frame<'a>(&mut self, body: &'a [u8]) -> Option<FrameOfData<'a>> {
        if let Some(frame) = FrameOfData::read(body, self.version) {
            return Some(frame);
        }
        let layouts =
            [Bitstream::NEWEST, Bitstream::new(3, 1), Bitstream::new(2, 11), Bitstream::OLDEST];
        let found = layouts.into_iter().find_map(|version| {
            let frame = FrameOfData::read(body, version).filter(|frame| frame.has_tag)?;
            Some((version, frame))
        });
        let (version, frame) = found?;
        self.remarks.push(format!(
            "frames have the layout of bitstream {version}, and not of {}: it is used from here on",
            self.version
        ));
        self.version = version;
        Some(frame)
    }

    pub(super) fn on_frame(&mut self, body: &[u8], on_event: Events<'_>) {
        let before = self.version;
        let Some(frame) = self.read_frame(body) else {
            return self.on_misfit(on_event);
        };
        let key = (frame.number, frame.end.ticks);
        let is_copy = self.run.is_port_open && self.run.last_key == Some(key);
        self.run.last_key = Some(key);
        self.run.misfits = 0;
        self.run.last_frame_ns = self.line.now_ns();
        self.run.is_idle_noted = false;
        if is_copy {
            // A server that sends to both ports of this machine.
            return;
        }
        if self.version.has_ticks() != self.first_version.has_ticks() {
            // Times of another clock: the recorder joins the stream again.
            self.release_held(on_event);
            return self.lose(format!("the server changed its bitstream to {}", self.version));
        }
        if self.version != before {
            self.pass_remarks(on_event);
        }
        let changed = frame.end.flags & MODELS_CHANGED != 0;
        let ahead = frame.number.wrapping_sub(self.run.number).cast_signed();
        if self.run.frames > 0 && ahead > 1 {
            // The frame that states a change may be lost.
            self.run.doubts_model = true;
        }
        if self.run.frames == 0 || ahead > 0 {
            self.run.number = frame.number;
        }
        if changed || self.run.doubts_model {
            self.request_model(changed);
        }
        if self.run.held.is_empty() && self.awaits_model_ns.is_none() {
            return self.decode(&frame, on_event);
        }
        self.run.held.push((self.version, body.to_vec()));
        if self.run.held.len() >= HELD_MAX {
            self.release_held(on_event);
        }
    }

    /// A frame of an unknown layout. After many in a row the server has changed to another one.
    fn on_misfit(&mut self, on_event: Events<'_>) {
        self.counters.messages_damaged += 1;
        self.run.misfits += 1;
        if self.run.misfits > MISFITS_MAX {
            self.release_held(on_event);
            let (version, newest) = (self.version, Bitstream::NEWEST);
            self.fail(&format!(
                "frames do not have the layout of bitstream {version}, nor any that mocapd reads ({} to {newest}): \
                 install another version of the server",
                Bitstream::OLDEST
            ));
        }
    }

    /// Requests the definitions again; not for every frame, if a server keeps stating that they changed. Frames wait for them
    /// only if they have changed: those that wait are reported later than they arrived.
    fn request_model(&mut self, changed: bool) {
        let now_ns = self.line.now_ns();
        let is_due = now_ns.saturating_sub(self.model_request_ns) > MODEL_INTERVAL_NS;
        if self.awaits_model_ns.is_some() || !(is_due || changed && !self.run.had_change) {
            self.run.doubts_model |= changed;
            return;
        }
        self.awaits_model_ns = changed.then_some(now_ns);
        self.run.had_change = changed;
        self.run.doubts_model = false;
        self.model_request_ns = now_ns;
        self.send_empty(MessageKind::RequestModel);
    }

    /// Decodes the frames that waited for definitions.
    fn release_held(&mut self, on_event: Events<'_>) {
        self.awaits_model_ns = None;
        for (version, body) in std::mem::take(&mut self.run.held) {
            match FrameOfData::read(&body, version) {
                Some(frame) => self.decode(&frame, on_event),
                None => self.counters.messages_damaged += 1,
            }
        }
    }

    /// The definitions came again.
    pub(super) fn on_new_model(&mut self, message: &Message<'_>, on_event: Events<'_>) {
        let before = self.labels.markers();
        let (sampled, bodies) = (self.model.sampled.clone(), self.bodies.infos.clone());
        self.read_model(message.body);
        self.use_model();
        self.run.searches = 0;
        let now = self.labels.markers();
        if now != before {
            on_event(DeviceEvent::Markers(&now));
            let n = now.len();
            self.note(&format!("the server's definitions changed: {n} labels"), on_event);
        }
        if self.bodies.infos != bodies {
            on_event(DeviceEvent::Bodies(&self.bodies.infos));
        }
        if self.model.sampled != sampled {
            self.note(
                "the server's force plates or devices changed: start again to record the new ones",
                on_event,
            );
        }
        self.pass_remarks(on_event);
        self.release_held(on_event);
    }

    fn decode(&mut self, frame: &FrameOfData<'_>, on_event: Events<'_>) {
        self.samples.clear();
        self.unlabelled.begin_frame();
        self.find_names(frame);
        frame.markers().for_each(|marker| self.add_marker(&marker, frame.has_flags()));
        if !frame.has_flags() {
            for (place, position_m) in frame.other_positions_m().enumerate() {
                self.add_unlabelled(BY_PLACE + place as u64, position_m, 0);
            }
        }
        let ticks = self.ticks_of(frame);
        let seq = self.axis.counter(frame.number, ticks / 1000);
        let run = &mut self.run;
        let index = match run.frames {
            0 => INDEX_BASE + u64::from(seq),
            _ => run.index.wrapping_add_signed(seq.wrapping_sub(run.last).cast_signed().into()),
        };
        if run.produced.follow(seq, ticks) {
            (run.last, run.index) = (seq, index);
        }
        run.last_ticks = ticks;
        run.frames += 1;
        self.had_frames = true;
        on_event(DeviceEvent::Frame(Frame {
            seq,
            device_ticks: ticks,
            timecode: timecode(frame.end.timecode),
            markers: &self.samples,
        }));
        if !self.bodies.infos.is_empty() {
            let poses = self.bodies.poses(frame);
            on_event(DeviceEvent::Poses(PoseFrame {
                seq,
                number: seq,
                device_ticks: ticks,
                poses,
            }));
        }
        self.sampled.pass_on(frame, index, ticks, on_event);
        for note in std::mem::take(&mut self.sampled.notes) {
            self.note(&note, on_event);
        }
    }

    /// Where markers have labels that no definition tells: their sets may have the same positions, or the definitions are old.
    fn find_names(&mut self, frame: &FrameOfData<'_>) {
        let is_unknown = |names: &MarkerNames, marker: &NatNetMarker| {
            is_labelled(marker, frame.has_flags()) && names.label(marker.id).is_none()
        };
        let has_unknown = |names: &MarkerNames| frame.markers().any(|m| is_unknown(names, &m));
        if !has_unknown(&self.names) {
            return;
        }
        if self.run.searches < SEARCHES_MAX {
            self.run.searches += 1;
            self.names.learn(frame);
            if !has_unknown(&self.names) {
                return;
            }
        }
        self.request_model(false);
    }

    fn add_marker(&mut self, marker: &NatNetMarker, has_flags: bool) {
        // Metres per ray.
        let residual_10um = residual_10um(1000.0 * f64::from(marker.residual_m));
        let is_seen = marker.flags & OCCLUDED == 0;
        let labelled = is_labelled(marker, has_flags);
        let label = self.names.label(marker.id).filter(|_| labelled);
        let Some(id) = label.and_then(|index| self.labels.id(index)) else {
            let of_asset = if labelled { NO_LABEL } else { 0 };
            if is_seen {
                let id = of_asset + u64::from(marker.id);
                self.add_unlabelled(id, marker.position_m, residual_10um);
            }
            return;
        };
        if !self.is_first(id) {
            self.run.repeated += 1;
            return;
        }
        let position_mm = in_mm(marker.position_m);
        let is_finite = position_mm.iter().all(|value| value.is_finite());
        self.counters.samples_not_finite += u64::from(is_seen && !is_finite);
        self.run.filled += u64::from(is_seen && marker.flags & MODEL_FILLED != 0);
        let occluded = !is_seen || !is_finite;
        let position_mm = if occluded { [0.0; 3] } else { position_mm };
        self.samples.push(MarkerSample { id, occluded, residual_10um, position_mm });
    }

    /// Whether a labelled marker has not been in this frame yet.
    fn is_first(&mut self, id: u16) -> bool {
        let index = usize::from(id);
        if self.seen.len() <= index {
            self.seen.resize(index + 1, 0);
        }
        let frame = self.run.frames + 1;
        self.seen.get_mut(index).is_some_and(|last| std::mem::replace(last, frame) != frame)
    }

    fn add_unlabelled(&mut self, vendor_id: u64, position_m: [f32; 3], residual_10um: u8) {
        let position_mm = in_mm(position_m);
        if !position_mm.iter().all(|value| value.is_finite()) {
            self.counters.samples_not_finite += 1;
            return;
        }
        let Some(id) = self.unlabelled.channel(vendor_id) else {
            self.run.excess += 1;
            return;
        };
        self.samples.push(MarkerSample { id, occluded: false, residual_10um, position_mm });
    }

    /// The server's clock at the exposure; where it is not stated, when the cameras' data had arrived.
    fn ticks_of(&mut self, frame: &FrameOfData<'_>) -> u64 {
        let [exposure, received, _] = frame.end.ticks;
        if !self.has_clock() {
            // A negative time and NaN become 0.
            return (frame.end.timestamp_s * 1e9).round() as u64;
        }
        if exposure != 0 {
            return self.in_ns(exposure);
        }
        self.run.without_exposure += 1;
        self.in_ns(received)
    }

    /// What is due by the clock during a stream.
    pub(super) fn tick_stream(&mut self, on_event: Events<'_>) {
        let now_ns = self.line.now_ns();
        if self.awaits_model_ns.is_some_and(|at_ns| now_ns.saturating_sub(at_ns) > MODEL_WAIT_NS) {
            self.release_held(on_event);
            // It may have been lost on the way.
            self.run.doubts_model = true;
        }
        let idle_ns = now_ns.saturating_sub(self.run.last_frame_ns);
        let is_idle = self.run.frames == 0 && idle_ns > IDLE_NS;
        if is_idle && self.source.is_none() && !self.run.is_port_open {
            // Servers differ in where they send frames for one client: to the socket of its commands, or to this port.
            self.run.is_port_open = true;
            let stream = self.server.as_ref().and_then(|server| server.stream);
            let port = stream.map(|stream| stream.port).filter(|port| *port > 0);
            let port = port.unwrap_or(DATA_PORT);
            self.line.send(LineCommand::Listen(DatagramSource { group: None, port }));
        }
        let since_joined_ns = now_ns.saturating_sub(self.run.joined_ns.max(self.run.last_frame_ns));
        if since_joined_ns > NO_FRAMES_NS {
            self.run.joined_ns = now_ns;
            self.note_idle(on_event);
            self.join_again();
        }
        if let Some(stranger) = self.line.stranger().filter(|_| self.run.frames > 0)
            && !std::mem::replace(&mut self.run.is_stranger_noted, true)
        {
            self.note(
                &format!(
                    "datagrams of another NatNet server come from {stranger}: they are left out"
                ),
                on_event,
            );
        }
    }

    /// No frames come: a switch or an interface that went may have lost the membership, and the server its client.
    fn join_again(&mut self) {
        match self.source {
            Some(source) => {
                self.line.send(LineCommand::StopListening);
                self.line.send(LineCommand::Listen(source));
            }
            None => self.send_connect(),
        }
    }

    /// Explains, once for each silence, why no frame comes.
    fn note_idle(&mut self, on_event: Events<'_>) {
        if std::mem::replace(&mut self.run.is_idle_noted, true) {
            return;
        }
        let text = match (self.line.stranger(), self.source) {
            (Some(stranger), _) => format!(
                "no frame comes from the address in the URI, but datagrams come from {stranger}: use natnet:{}",
                stranger.ip()
            ),
            (None, Some(source)) => format!(
                "no frame comes from {source}: either the server sends none (Motive: live, or playing), or they go to \
                 another network (Motive: Local Interface; here: local=), or a firewall or a switch blocks multicast; with \
                 Transmission Type Unicast they come to this machine alone"
            ),
            (None, None) => "no frame comes: either the server sends none (Motive: live, or playing), or its Transmission \
                             Type is not Unicast, or a firewall blocks UDP"
                .to_owned(),
        };
        self.note(&text, on_event);
    }
}

/// A timecode as hours, minutes, seconds and frames; `None` without one.
fn timecode(bits: u32) -> Option<[u8; 4]> {
    let parts = bits.to_be_bytes();
    let [hours, minutes, seconds, _] = parts;
    (bits != 0 && hours < 24 && minutes < 60 && seconds < 60).then_some(parts)
}

impl NatNetHost {
    /// Reports at the end of a stream what was unusual in it.
    pub(super) fn report_end(&mut self, on_event: Events<'_>) {
        self.release_held(on_event);
        let run = &mut self.run;
        if run.frames > 0 && !self.bodies.infos.is_empty() {
            let (seq, device_ticks) = (run.last.wrapping_add(1), run.last_ticks);
            on_event(DeviceEvent::EndOfPoses(EndOfPoses { seq, number: seq, device_ticks }));
        }
        let counts = [
            (
                &mut run.filled,
                "samples were computed by the server from other markers, not measured",
            ),
            (
                &mut run.without_exposure,
                "frames have no time of exposure: that of their arrival is used",
            ),
            (&mut run.repeated, "samples of labels that were twice in a frame were left out"),
            (&mut run.excess, "unlabelled samples were left out: too many at once"),
            (
                &mut self.sampled.n_misfits,
                "times force plates or devices had other channels or samples than announced: left out",
            ),
        ];
        for (count, what) in counts {
            let count = std::mem::take(count);
            if count > 0 {
                on_event(DeviceEvent::Note(&format!("{count} {what}")));
            }
        }
    }
}

/// The state of a stream.
#[derive(Debug, Default)]
pub(super) struct NatNetRun {
    /// When the last frame came, or frames were wanted; and when their group was joined again.
    last_frame_ns: u64,
    joined_ns: u64,
    /// Number and stamps of the last frame.
    last_key: Option<(u32, [u64; 3])>,
    /// Whether definitions were requested because they changed.
    had_change: bool,
    is_stranger_noted: bool,
    /// Frames by their counters.
    produced: ProducedFrames,
    /// Counter of the last frame that was not late, also as the number of the frame.
    pub(super) last: u32,
    pub(super) index: u64,
    /// The server's clock at the last frame.
    pub(super) last_ticks: u64,
    pub(super) frames: u64,
    pub(super) notes: u32,
    pub(super) is_idle_noted: bool,
    is_port_open: bool,
    /// Frames whose sets were searched for names.
    pub(super) searches: u32,
    /// Number of the last frame that was not late.
    pub(super) number: u32,
    /// Whether the definitions may have changed.
    doubts_model: bool,
    /// Frames that wait for definitions, each with its layout.
    pub(super) held: Vec<(Bitstream, Vec<u8>)>,
    /// Frames of an unknown layout.
    misfits: u64,
    /// Frames without the time of their exposure.
    without_exposure: u64,
    /// Markers whose positions are computed, and those without a channel.
    pub(super) filled: u64,
    pub(super) excess: u64,
    /// Markers whose label was in their frame already.
    pub(super) repeated: u64,
}

impl NatNetRun {
    pub(super) fn new(hello: &Hello) -> Self {
        let produced = ProducedFrames::new(hello.rate_millihertz, hello.tick_hz);
        Self { produced, ..Self::default() }
    }

    /// The final counters. The server does not state how many frames it made: these are frames by their numbers.
    pub(super) fn status(&self) -> Status {
        let frames_produced = self.produced.produced();
        Status { frames_produced, frames_dropped: 0, temperature_c_100: i16::MIN }
    }
}
