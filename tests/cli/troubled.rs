//! Devices that stall, are reset, or lose their power while the line to them stays.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use mocapd_drivers::{
    device::{DeviceEvent, Protocol},
    link::HostLink,
};
use mocapd_simulator::{
    device::{Device, DeviceSettings, LineDevice, SentFrame, SentLog},
    faults::{FaultyDevice, Script},
    ndi::{NdiDevice, NdiSettings},
};
use mocapd_take::motion::Motion;

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump, mentions};

/// A device whose trouble begins some time after its first command.
struct Troubled<D> {
    device: D,
    trouble: Option<Trouble<D>>,
    begun_ns: Option<u64>,
    /// When the device last ran.
    last_ns: Option<u64>,
    /// Number of times that the machine stalled the device long enough to make it silent.
    starved: Arc<AtomicU64>,
}

enum Trouble<D> {
    /// It stalls.
    Stalls(Duration),
    /// It is reset, as by a break.
    IsReset,
    /// It is replaced by this device.
    IsAnother(Box<D>),
}

const AFTER_NS: u64 = 1_500_000_000;

/// A device that is not run for this long is silent. An NDI host gives up after three polls of 100 ms each and the pauses
/// between them: with stalls of 200 to 420 ms it continued, with 530 ms it set the system up again.
const STARVED_NS: u64 = 250_000_000;

impl<D> Troubled<D> {
    /// Also returns the count of its unplanned silences.
    fn new(device: D, trouble: Trouble<D>) -> (Self, Arc<AtomicU64>) {
        let starved = Arc::new(AtomicU64::new(0));
        let (trouble, count) = (Some(trouble), Arc::clone(&starved));
        (Self { device, trouble, begun_ns: None, last_ns: None, starved }, count)
    }

    /// Notes that the device runs: it is polled every 10 ms, so a longer pause is due to the machine.
    fn runs(&mut self, now_ns: u64) {
        let last_ns = self.last_ns.replace(now_ns).filter(|_| self.begun_ns.is_some());
        let is_starved = last_ns.is_some_and(|last_ns| now_ns - last_ns > STARVED_NS);
        self.starved.fetch_add(u64::from(is_starved), Ordering::Relaxed);
    }
}

impl<D: LineDevice> LineDevice for Troubled<D> {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.runs(now_ns);
        self.begun_ns.get_or_insert(now_ns);
        self.device.on_bytes(bytes, now_ns);
    }

    fn on_break(&mut self, now_ns: u64) {
        self.device.on_break(now_ns);
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        self.runs(now_ns);
        let is_time = self.begun_ns.is_some_and(|begun_ns| now_ns - begun_ns > AFTER_NS);
        match self.trouble.take_if(|_| is_time) {
            None => {}
            Some(Trouble::Stalls(time)) => {
                std::thread::sleep(time);
                // This silence is intended.
                self.last_ns = None;
            }
            Some(Trouble::IsReset) => self.device.on_break(now_ns),
            Some(Trouble::IsAnother(other)) => self.device = *other,
        }
        // Polled often enough for the trouble to begin in time.
        self.device.poll(now_ns).min(now_ns + 10_000_000)
    }

    fn pending(&self) -> &[u8] {
        self.device.pending()
    }

    fn sent(&mut self, n: usize) {
        self.device.sent(n);
    }

    fn baud(&self) -> Option<u32> {
        self.device.baud()
    }

    fn has_ended(&self) -> bool {
        self.device.has_ended()
    }

    fn log(&self) -> SentLog {
        self.device.log()
    }

    fn keep_frame_log(&mut self) {
        self.device.keep_frame_log();
    }

    fn take_frames(&mut self) -> Vec<SentFrame> {
        self.device.take_frames()
    }
}

/// Records for `seconds`: the ledger closes, the take has that length, and frames to its end.
fn recorded(device: &Simulated, driver: &str, seconds: f64) -> serde_json::Value {
    let folder = Folder::new();
    let uri = format!("{}{driver}", device.uri());
    let time = format!("{seconds}s");
    let ran = folder.run(&["record", "-d", &uri, "-o", "a.take", "--seconds", &time, "--json"]);
    let report = ran.json();
    assert_eq!(report["ending"], "stopped", "{}", ran.stderr);
    assert_eq!(report["ledger"]["closes"], true, "{}", report["ledger"]);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    let lasted_s = info["seconds"].as_f64().unwrap();
    assert!((lasted_s - seconds).abs() < 1.2, "{lasted_s} s for {seconds}: {}", ran.stderr);
    folder.run(&["export", "a.take", "-o", "a.csv"]);
    let table = folder.text("a.csv");
    let last_rows = table.lines().rev().take(20);
    let has_samples = |line: &str| line.split(',').skip(2).any(|cell| !cell.is_empty());
    assert!(
        last_rows.into_iter().any(has_samples),
        "it ends with rows that nobody sent: {}",
        ran.stderr
    );
    info
}

/// The device was away once, and an event states the missing frames. A busy machine can silence it `starved` times more.
#[track_caller]
fn assert_away(info: &serde_json::Value, starved: u64) {
    let count = info["outages"]["count"].as_u64().unwrap();
    assert!((1..=1 + starved).contains(&count), "{count}, starved {starved}: {}", info["events"]);
    let n_lost = info["outages"]["frames"].to_string();
    let mut events = info["events"].as_array().unwrap().iter();
    let states_loss = |event: &serde_json::Value| {
        event["kind"] == "host" && mentions(event["text"].as_str().unwrap(), &n_lost)
    };
    assert!(events.any(states_loss), "{n_lost} frames: {}", info["events"]);
}

#[test]
fn an_ndi_system_that_stalls_or_is_reset_or_replaced_invents_no_frame() {
    let system = || {
        let motion = jump(6, 60.0, 2.0);
        let settings =
            NdiSettings { tools: vec!["head".into()], looping: true, ..NdiSettings::default() };
        NdiDevice::new(motion, settings).unwrap()
    };
    for trouble in [
        Trouble::Stalls(Duration::from_millis(900)),
        Trouble::IsReset,
        Trouble::IsAnother(Box::new(system())),
    ] {
        let (troubled, starved) = Troubled::new(system(), trouble);
        let device = Simulated::serve(troubled, None);
        let info = recorded(&device, "?driver=ndi", 6.0);
        assert_away(&info, starved.load(Ordering::Relaxed));
    }
}

/// A rig on a UART adapter: the port stays when the rig loses its power.
#[test]
fn a_device_that_loses_its_power_while_the_line_stays_is_started_again() {
    let device = || {
        let settings = DeviceSettings {
            looping: true,
            queue_bytes: Some(64 << 20),
            ..DeviceSettings::default()
        };
        Device::new(jump(7, 120.0, 2.0), settings).unwrap()
    };
    let (troubled, starved) = Troubled::new(device(), Trouble::IsAnother(Box::new(device())));
    let device = Simulated::serve(troubled, None);
    assert_away(&recorded(&device, "", 16.0), starved.load(Ordering::Relaxed));
}

/// Frames lost on the line do not restart the device over and over: it is started rarely, and the take keeps
/// time.
#[test]
fn a_line_that_loses_every_frame_for_long_costs_those_frames_and_a_start() {
    let text = "seed = 1\n[[fault]]\nkind = \"lost-frames\"\nrate = 1\nfrom_s = 1\nto_s = 13\n";
    let script = Arc::new(Script::parse("long.toml", text).unwrap());
    let settings = DeviceSettings {
        looping: true,
        queue_bytes: Some(64 << 20),
        faults: Some(Arc::clone(&script)),
        ..DeviceSettings::default()
    };
    let device = Device::new(jump(8, 120.0, 2.0), settings).unwrap();
    let device = Simulated::serve(FaultyDevice::new(device, &script), None);
    let info = recorded(&device, "", 16.0);
    let starts = device.unplug().starts;
    assert_eq!(starts, 2, "{}", info["events"]);
    assert_away(&info, 0);
}

/// A device on a line that damages the end of its stream, and a number of its reports.
struct Spoilt {
    device: Device,
    reader: HostLink,
    out: Vec<u8>,
    has_run: bool,
    has_ended: bool,
    reports: u32,
}

impl Spoilt {
    fn new(motion: Motion, reports: u32) -> Self {
        let device = Device::new(motion, DeviceSettings::default()).unwrap();
        Self {
            device,
            reader: HostLink::new(),
            out: Vec::new(),
            has_run: false,
            has_ended: false,
            reports,
        }
    }

    fn carry(&mut self) {
        while let Some(end) = self.device.pending().iter().position(|byte| *byte == 0) {
            let mut message = self.device.pending()[..=end].to_vec();
            self.device.sent(message.len());
            let (mut is_end, mut is_report, mut is_frame) = (false, false, false);
            self.reader.push(&message, &mut |event| {
                is_end = matches!(event, DeviceEvent::EndOfStream(_));
                is_report = matches!(event, DeviceEvent::Status(_));
                is_frame = matches!(event, DeviceEvent::Frame(_));
            });
            let spoils_report = is_report && self.has_ended && self.reports > 0;
            self.has_run |= is_frame;
            // Replies to a Stop are exempt: whether they are read and counted depends on timing.
            let spoils_end = is_end && self.has_run && !self.has_ended;
            if spoils_end || spoils_report {
                self.has_ended = true;
                self.reports -= u32::from(spoils_report);
                message[3] ^= 0x55;
                message[3] |= 1;
            }
            self.out.extend(message);
        }
    }
}

impl LineDevice for Spoilt {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.device.on_bytes(bytes, now_ns);
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        let next_ns = self.device.poll(now_ns);
        self.carry();
        next_ns
    }

    fn pending(&self) -> &[u8] {
        &self.out
    }

    fn sent(&mut self, n: usize) {
        self.out.drain(..n);
    }

    fn has_ended(&self) -> bool {
        self.device.has_ended()
    }

    fn log(&self) -> SentLog {
        self.device.log()
    }

    fn keep_frame_log(&mut self) {}

    fn take_frames(&mut self) -> Vec<SentFrame> {
        Vec::new()
    }
}

/// A silent host asks, and learns that the whole motion was sent; it is not played again.
#[test]
fn a_stream_ends_even_if_its_end_is_lost() {
    std::thread::scope(|scope| {
        for reports in [0, 1] {
            scope.spawn(move || {
                let folder = Folder::new();
                let device = Simulated::serve(Spoilt::new(jump(9, 120.0, 1.0), reports), None);
                let ran = folder.run(&["record", "-d", &device.uri(), "-o", "a.take", "--json"]);
                let ran = ran.with_code(0);
                let report = ran.json();
                assert_eq!(report["ending"], "end of stream");
                assert_eq!(report["ledger"]["recorded"], 120);
                assert_eq!(report["ledger"]["frames_sent"], 120);
                assert_eq!(report["ledger"]["link_messages_damaged"], 1 + reports);
                assert_eq!(device.unplug().starts, 1);
                let info = folder.run(&["info", "a.take", "--json"]).json();
                assert_eq!(info["outages"]["count"], 0, "{info}");
                let event = &info["events"][0];
                assert_eq!(event["kind"], "host", "{info}");
                // The recorder is notified as well.
                let event = event["text"].as_str().unwrap();
                assert_mentions(event, &["end-of-stream message was lost"]);
                assert_mentions(&ran.stderr, &[event]);
            });
        }
    });
}
