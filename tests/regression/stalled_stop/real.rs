//! Stalls in real time: the service as a program, with a simulated device on a line.

use std::{
    process::Child,
    sync::Arc,
    thread::sleep,
    time::{Duration, Instant},
};

use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::{FaultyDevice, Script},
};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    cli::{Folder, Ran, devices::Simulated},
    support::{Seeded, jump},
};

/// What stalls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stalled {
    /// The device sends nothing.
    Device,
    /// The whole service, by SIGSTOP.
    Service,
    /// The thread that writes, as by a disk: in builds with the feature `fault-hooks`.
    #[cfg(feature = "fault-hooks")]
    Writer,
}

const STALLED: &[Stalled] = &[
    #[cfg(feature = "fault-hooks")]
    Stalled::Writer,
    Stalled::Service,
    Stalled::Device,
];

/// A command or signal, and its time in seconds since the start of the service.
#[derive(Debug, Clone, Copy)]
enum Act {
    Signal(Signal),
    Command(&'static [&'static str]),
}

const START: Act = Act::Command(&["start"]);
// Longer than any stall, because nothing is buffered of a device that stalls.
const SAVE_LAST: Act = Act::Command(&["save-last", "40s"]);
const STOP: Act = Act::Command(&["stop"]);

const CONFIG: &str = "[http]
socket = 'rig.sock'
listen = ''
[take]
name = 'take-{count}'
[arm]
pre_roll = '60s'
";

/// Longer than any stall, and than `ctl` waits for an answer.
const GIVE_UP: Duration = Duration::from_secs(90);

fn ended(mut child: Child) -> Ran {
    let since = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(since.elapsed() < GIVE_UP, "it does not end");
        sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap().into()
}

fn seconds(rng: &mut Seeded, from: f64, to: f64) -> f64 {
    from + (to - from) * rng.below(1001) as f64 / 1e3
}

/// A service whose device, process or writer stalls around a start, a save-last or a stop: what happened, and what
/// `verify` says of each of its takes.
pub(super) fn stall(seed: u64) -> (String, Vec<(String, Ran)>) {
    let mut rng = Seeded::new(seed);
    let stalled = STALLED[seed as usize % STALLED.len()];
    let (from_s, for_s) = (seconds(&mut rng, 4.0, 12.0), seconds(&mut rng, 1.0, 30.0));
    let to_s = from_s + for_s;
    let near_s = seconds(&mut rng, from_s - 0.3, to_s + 0.1);
    let after_s = to_s.max(near_s) + 3.0;
    let mut acts = match seed as usize / STALLED.len() % 3 {
        0 => vec![(1.0, START), (near_s, STOP)],
        1 => vec![(1.0, START), (near_s, SAVE_LAST), (after_s, STOP)],
        _ => vec![(near_s, START), (after_s, STOP)],
    };
    match stalled {
        Stalled::Device => {}
        Stalled::Service => {
            acts.extend([(from_s, Act::Signal(Signal::STOP)), (to_s, Act::Signal(Signal::CONT))]);
        }
        #[cfg(feature = "fault-hooks")]
        Stalled::Writer => {
            acts.extend([(from_s, Act::Signal(Signal::USR2)), (to_s, Act::Signal(Signal::USR1))]);
        }
    }
    acts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut story = format!("{seed}: {stalled:?} for {for_s:.1} s from {from_s:.1} s on; {acts:?}");

    let folder = Folder::new();
    folder.write("rig.toml", CONFIG);
    let device = device(stalled, from_s, for_s);
    let uri = device.uri();
    let run = ["run", "--config", "rig.toml", "--device", &uri, "--directory", "."];
    let service = folder.command(&run).env("MOCAPD_HANG", "writer").spawn().unwrap();
    let pid = Pid::from_child(&service);
    let ctl =
        |args: &[&str]| folder.command(&[&["ctl", "--connect", "unix:rig.sock"], args].concat());
    let begun = Instant::now();
    let mut commands = Vec::new();
    for (at_s, act) in acts {
        sleep(Duration::from_secs_f64(at_s).saturating_sub(begun.elapsed()));
        match act {
            Act::Signal(signal) => kill_process(pid, signal).unwrap(),
            Act::Command(args) => commands.push((args, ctl(args).spawn().unwrap())),
        }
    }
    for (args, command) in commands {
        // One may be refused: a start that finds no disk for five seconds, and the stop after it.
        let ran = ended(command);
        story += &format!("\n  {args:?}: {:?} {}", ran.code, ran.stderr.trim_end());
    }
    kill_process(pid, Signal::TERM).unwrap();
    let ran = ended(service);
    assert!(matches!(ran.code, Some(0 | 3)), "{seed}: {ran:?}");
    let takes =
        folder.content().into_keys().filter(|path| path.extension() == Some("take".as_ref()));
    let verified = takes.map(|take| {
        let take = take.to_str().unwrap().to_owned();
        let ran = folder.run(&["verify", &take, "--json"]);
        (take, ran)
    });
    (story, verified.collect())
}

fn device(stalled: Stalled, at_s: f64, for_s: f64) -> Simulated {
    let mut text = "seed = 1\n".to_owned();
    if stalled == Stalled::Device {
        text += &format!("[[fault]]\nkind = 'stall'\nat_s = {at_s:.3}\nfor_s = {for_s:.3}\n");
    }
    let script = Arc::new(Script::parse("stall", &text).unwrap());
    let faults = Some(Arc::clone(&script));
    let settings =
        DeviceSettings { looping: true, drift_ppm: 150.0, faults, ..DeviceSettings::default() };
    let device = Device::new(jump(1, 120.0, 3.0), settings).unwrap();
    Simulated::serve(FaultyDevice::new(device, &script), None)
}
