//! From a connection to a QTM that is ready to send: greeting, version, state and settings, one request at a time.

use super::{
    axis::FrameAxis,
    command::{VERSIONS, WELCOME},
    host::{Fence, QtmHost, SessionState, Step, is_byte_order},
    labels::UNLABELLED_MAX,
    packet::{Packet, PacketKind, printable},
    settings::Settings,
    stream_run::Renewal,
};
use crate::device::{BODIES_MAX, Hello};

/// Frame rates that QTM's cameras have, in Hz: 1 Hz, to more than the fastest at a reduced image.
const RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=100_000.0;

impl QtmHost {
    /// Waits for QTM's greeting.
    pub(super) fn begin_bring_up(&mut self) {
        self.request_ns = self.line.now_ns();
        self.remarks.clear();
        self.state = SessionState::BringUp(Step::Welcome);
    }

    /// Asks again for what may have changed.
    pub(super) fn ask_again(&mut self) {
        self.fence = None;
        self.remarks.clear();
        // The fence's reply must not be taken for that of a later step: `ByteOrder` is asked first.
        self.ask(Step::ByteOrder);
    }

    fn ask(&mut self, step: Step) {
        self.state = SessionState::BringUp(step);
        match step {
            Step::Welcome => {}
            Step::Version(minor) => self.send(&format!("Version 1.{minor}")),
            Step::QtmVersion => self.send("QTMVersion"),
            Step::ByteOrder => {
                self.fences_due += 1;
                self.send("ByteOrder");
            }
            // Until version 1.9 it was called GetLastEvent.
            Step::State if self.minor < 10 => self.send("GetLastEvent"),
            Step::State => self.send("GetState"),
            Step::General => self.send("GetParameters General"),
            Step::Markers => self.send("GetParameters 3D"),
            Step::Bodies => self.send("GetParameters 6D"),
            Step::Analog => self.send("GetParameters Analog"),
            Step::Force => self.send("GetParameters Force"),
        }
    }

    pub(super) fn on_bring_up_reply(&mut self, step: Step, packet: &Packet<'_>) {
        let text = packet.text();
        let is_error = packet.kind == Some(PacketKind::Error);
        match step {
            Step::Welcome if !is_error && text.starts_with(WELCOME) => {
                self.ask(Step::Version(*VERSIONS.end()));
            }
            Step::Welcome => {
                let text = printable(&text);
                self.fail(&format!("QTM refuses the connection ({text}): close other clients, or restart QTM"));
            }
            Step::Version(minor) if !is_error && text.trim() == format!("Version set to 1.{minor}") => {
                self.minor = minor;
                self.ask(Step::QtmVersion);
            }
            Step::Version(minor) if minor > *VERSIONS.start() => self.ask(Step::Version(minor - 1)),
            Step::Version(_) => self.fail(&format!(
                "QTM speaks no version of its protocol from 1.{} to 1.{} ({}): install another version of QTM",
                VERSIONS.start(),
                VERSIONS.end(),
                printable(&text)
            )),
            Step::QtmVersion => {
                let version = printable(text.trim().trim_start_matches("QTM Version is "));
                let protocol = format!("RT protocol 1.{}", self.minor);
                self.hello.firmware = if is_error { protocol } else { format!("{version}, {protocol}") };
                self.ask(Step::ByteOrder);
            }
            Step::ByteOrder => self.on_byte_order(packet, &text),
            // The reply is an event; older versions reply nothing before the first change.
            Step::State => self.ask(Step::General),
            Step::General | Step::Markers => self.on_required_settings(step, packet),
            Step::Bodies | Step::Analog | Step::Force => {
                // What does not exist is an error, and no reason not to record the markers.
                let settings = if is_error { Ok(Settings::default()) } else { Settings::parse(&text) };
                let settings = settings.unwrap_or_else(|problem| {
                    self.remarks.push(format!("a part of QTM's settings cannot be read, and is not recorded: {}", printable(&problem)));
                    Settings::default()
                });
                self.on_other_settings(step, &settings);
            }
        }
    }

    /// The reply to `ByteOrder`, or to what was requested before it during a stream that is stopped now.
    fn on_byte_order(&mut self, packet: &Packet<'_>, text: &str) {
        if !is_byte_order(packet) {
            let was_requested = self.renewal.forget_one();
            if !was_requested && packet.kind == Some(PacketKind::Error) {
                self.ask(Step::State);
            }
            return;
        }
        self.fences_due = self.fences_due.saturating_sub(1);
        if self.fences_due > 0 {
            return;
        }
        // All earlier requests have been replied to.
        self.renewal = Renewal::default();
        if text.starts_with("Byte order is big") {
            return self.fail(
                "QTM sends in the other byte order: give its little-endian port, the base port + 1 (22223 by default)",
            );
        }
        self.ask(Step::State);
    }

    /// An event arrived, which may be the one that a step waits for.
    pub(super) fn on_state_reply(&mut self) {
        if self.state == SessionState::BringUp(Step::State) {
            self.ask(Step::General);
        }
    }

    fn on_required_settings(&mut self, step: Step, packet: &Packet<'_>) {
        if packet.kind != Some(PacketKind::Xml) {
            let text = printable(&packet.text());
            self.fail(&format!(
                "QTM has no measurement to send ({text}): connect it to its cameras (New), or open a file and choose \
                 Run real-time from file"
            ));
            return;
        }
        match Settings::parse(&packet.text()) {
            Err(problem) => self.fail(&format!("QTM's settings cannot be read: {problem}")),
            Ok(settings) if step == Step::General => {
                let Some(rate_hz) = settings.frequency_hz.filter(|hz| RATE_HZ.contains(hz)) else {
                    self.fail(
                        "QTM states no frame rate: set the capture rate in its project options",
                    );
                    return;
                };
                self.hello.rate_millihertz = (rate_hz * 1000.0).round() as u32;
                self.ask(Step::Markers);
            }
            Ok(settings) => {
                let Some(labels) = settings.labels else {
                    self.fail(
                        "QTM sends no 3D data: switch on 3D tracking in its real-time actions",
                    );
                    return;
                };
                let n_excess = self.labels.update(&labels);
                if n_excess > 0 {
                    self.remarks.push(format!(
                        "{n_excess} labels are too many: their markers are unlabelled"
                    ));
                }
                self.set_up_axis(settings.up_axis.as_deref());
                self.ask(Step::Bodies);
            }
        }
    }

    fn set_up_axis(&mut self, axis: Option<&str>) {
        self.hello.up_axis = match axis.map(str::to_ascii_uppercase).as_deref() {
            Some("+X") => 1,
            Some("+Y") => 2,
            Some("+Z") => 3,
            Some(axis @ ("-X" | "-Y" | "-Z")) => {
                self.remarks
                    .push(format!("QTM's {axis} axis points up, which a take cannot state"));
                0
            }
            _ => 0,
        };
    }

    fn on_other_settings(&mut self, step: Step, settings: &Settings) {
        match step {
            Step::Bodies => {
                let n_excess = self.bodies.update(settings.bodies.as_deref().unwrap_or_default());
                if n_excess > 0 {
                    self.remarks.push(format!(
                        "{n_excess} rigid bodies are too many, and are not recorded: at most {BODIES_MAX} can be"
                    ));
                }
                self.sampled.clear();
                self.ask(Step::Analog);
            }
            Step::Analog => {
                self.sampled.add_analog(&settings.analog);
                self.ask(Step::Force);
            }
            _ => {
                self.sampled.add_plates(&settings.plates, &settings.force_units);
                if self.sampled.left_out() > 0 {
                    self.remarks.push(format!(
                        "{} analog devices or force plates of QTM are not recorded: there are more than 16, or their \
                         rates are out of range",
                        self.sampled.left_out()
                    ));
                }
                self.set_ready();
            }
        }
    }

    fn set_ready(&mut self) {
        let rate_millihertz = self.hello.rate_millihertz;
        self.hello = Hello {
            model: "QTM".to_owned(),
            rate_min_millihertz: rate_millihertz,
            rate_max_millihertz: rate_millihertz,
            tick_hz: 1_000_000,
            markers_max: (self.labels.n_labels() + UNLABELLED_MAX) as u16,
            ..std::mem::take(&mut self.hello)
        };
        self.axis = FrameAxis::new(rate_millihertz);
        self.fence = None::<Fence>;
        self.state = SessionState::Ready;
    }

    pub(super) fn on_bring_up_timeout(&mut self, step: Step) {
        match step {
            Step::Welcome => self.fail(
                "the connection is open, but nobody greets: check that this is QTM's little-endian port, the base \
                 port + 1 (22223 by default), and that QTM is not busy",
            ),
            // Older versions reply nothing before the first change.
            Step::State => self.ask(Step::General),
            _ => self.fail("QTM does not answer: it may be busy with another task; try again, or restart it"),
        }
    }
}
