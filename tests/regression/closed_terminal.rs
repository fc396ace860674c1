//! A closed terminal or a dropped SSH connection ends a recording like Ctrl-C, with an intact take.

use rustix::process::Signal;

use crate::{
    cli::{
        Folder,
        devices::{Recorder, Simulated},
    },
    support::jump,
};

/// Whether the processes of this test ignore SIGHUP, as under `nohup`.
fn is_hangup_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    u64::from_str_radix(mask.trim(), 16).unwrap() & 1 == 1
}

#[test]
fn the_take_is_closed_when_the_terminal_is() {
    for signal in [Signal::HUP, Signal::QUIT] {
        if signal == Signal::HUP && is_hangup_ignored() {
            continue;
        }
        let folder = Folder::new();
        let device = Simulated::endless(jump(1, 120.0, 2.0));
        let mut recorder = Recorder::start(&folder, &device, "a.take", &["--json"]);
        std::thread::sleep(std::time::Duration::from_millis(600));
        recorder.signal(signal);
        recorder.wait().with_code(0);
        let info = folder.run(&["info", "a.take", "--json"]).with_code(0).json();
        assert_eq!((&info["finished"], &info["health"]), (&true.into(), &"complete".into()));
    }
}
